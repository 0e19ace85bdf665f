"""Tables, figures and pages.  Numbers are computed below; here they are only shown."""
