"""What each task can be asked, once: the command line and the studio's interface are derived from these classes."""
