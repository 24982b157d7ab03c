"""Work of several rooms together: from files to files, without options of a command line."""
