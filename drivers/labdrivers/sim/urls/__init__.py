"""The package in which pyserial looks for the handler of ``sim://`` (see `protocol_sim`)."""
