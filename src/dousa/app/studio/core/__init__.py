"""What the rooms of the studio stand on: settings and folder, who may come in, what is answered, in which words."""
