"""Safe reading of files of unknown origin, and writing of whole files: never half a file."""
