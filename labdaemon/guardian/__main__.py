"""Runs the guardian: ``python -I -S …/guardian/__main__.py FOLDER…``, the folders that hold labdaemon and pyserial.

Without the site packages' own start-up files nothing else is imported.
"""

from __future__ import annotations

import sys

if __name__ == "__main__":
    sys.path += sys.argv[1:]
    # pyserial finds the handlers of URLs by name when a port is opened: load them while the disk still answers
    import serial.urlhandler.protocol_rfc2217
    import serial.urlhandler.protocol_socket  # noqa: F401

    from labdaemon.guardian.heartbeat_monitor import main

    sys.exit(main())
