"""Prints the command line that started it, as results would tell it."""

from wovenfab.record.results import this_process

print(this_process().command)
print(this_process(ranks=2).command)
