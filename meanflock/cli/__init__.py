"""The command line: flags, texts and exit codes around calls of the library."""
