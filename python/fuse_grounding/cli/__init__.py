"""The command line: a file a command, a few lines over the library."""
