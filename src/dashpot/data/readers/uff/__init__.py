"""Universal files (UFF, UNV): functions at nodes (datasets 58, 58b), data at nodes (dataset 55); read and written."""
