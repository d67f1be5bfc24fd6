"""The motion along the windows of a fit, and its derivatives by a parameter, a force, or a change of the belt."""
