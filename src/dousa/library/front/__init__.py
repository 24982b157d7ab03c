"""The object that people use: what a library contains, what is changed in it by hand, and all that is asked of it."""
