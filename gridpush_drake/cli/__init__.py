"""The command line, one short file for each command.

`main` has the table of commands. A command's file is imported only when the command is asked for,
so that `gridpush` starts fast whatever the files import.
"""
