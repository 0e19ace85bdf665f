"""Models of rigs: elements, the network they form, its dynamics, and the files that describe it."""
