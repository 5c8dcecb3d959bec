"""The command line, one short file per command.

What is slow to import is imported when a command runs, so that `gridpush` starts fast.
"""
