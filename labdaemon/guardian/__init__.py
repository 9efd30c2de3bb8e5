"""The guardian: a tiny process that outlives the daemon and brings the table to rest when the daemon cannot.

It imports the standard library and pyserial alone, so that it starts at once, needs little memory and has little that
can fail. What it sends to the shaker comes from the driver as data (`labdaemon.guardian.recipe`). The daemon's side is
`labdaemon.service.guardian_supervisor`.
"""
