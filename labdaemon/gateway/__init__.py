"""The text gateway: captures, envelopes and `stop` for LabVIEW, MATLAB and any program that speaks SCPI over TCP."""
