"""labdaemon: shaker, synchronised cameras, and vibration measured from motion blur."""

__version__ = "0.1.0"
