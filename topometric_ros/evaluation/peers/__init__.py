"""Methods that a user would pick instead of this package, behind one interface."""
