"""HTTP for what speaks no ZeroMQ: curl, Excel, a browser. Needs the extra ``labdaemon[web]``."""
