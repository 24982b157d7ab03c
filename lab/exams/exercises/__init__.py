"""An exam of the judge of exercises, written from the words of its task before anything of the evaluation was read."""
