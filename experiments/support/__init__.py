"""What every command needs, whatever it measures.

errors      what a user can put right, in one line
files       whole or not at all
threads     one thread a process
provenance  versions, machine, revision
"""
