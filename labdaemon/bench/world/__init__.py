"""`labdaemon bench world`: the running daemon against devices, disks, sockets and endings as a laboratory has them.

Each section is a module of this package with one function ``rows(options)``; `labdaemon.bench.world.sections` lists
them. A section yields a row of the table for each kind of trouble that it tries, through real processes.
"""
