"""The command line. A command is a call of the library; what its files hold is flags, words and exit codes."""
