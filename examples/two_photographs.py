"""Measure two photographs: ``python two_photographs.py SHARP BLURRED``."""

from __future__ import annotations

import sys

import labdaemon as ld


def main(sharp: str, blurred: str) -> None:
    """Print one line per dot."""
    motion = ld.measure(sharp, blurred)
    print(motion)
    for dot in motion:
        x, y = dot.centre_px
        flags = ", ".join(sorted(dot.flags)) or "ok"
        print(f"{dot.target}  at ({x:7.1f}, {y:7.1f}) px  {dot.amplitude_px:7.3f} ± {dot.sd_px:.3f} px  {flags}")


if __name__ == "__main__":
    main(*sys.argv[1:3])
