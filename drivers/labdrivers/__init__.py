"""Drivers for labdaemon: one module or folder a protocol, each found by an entry point.

=====================  ============================================================================================
`scpi`                 a shaker's generator or controller, in SCPI or its own commands (`scpi_commands`, `scpi_link`)
`trigger_box`          the trigger box, in the protocol of `trigger_wire`
`rts_trigger`          the RTS line of a serial adapter, for labs without a box
`ptp`                  cameras over USB
`gauge`                displacement and acceleration gauges that stream
`serial_line`          the one module that knows pyserial; `ptp.transport` is the one that knows pyusb
`sim`                  the simulated rig: physics, renderer, and a device at the far end of each of these wires
=====================  ============================================================================================

No driver knows `sim`: a simulated device is a port (``sim://shaker``, a pty, ``socket://…``) or a USB backend.
"""
