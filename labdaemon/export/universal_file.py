"""Universal File Format: header 151, units 164, nodes 2411, trace line 82, shapes 55, transmissibility 58. SI units.

Node numbers follow the order in which targets first occur; the name of a target stands in the first ID line of its
functions (58). A shape (55) is the complex amplitude U of an envelope, d(t) = Re(U exp(iωt)); without phase its real
part is the major semi-axis and the imaginary part is zero. The format is described by the SDRC universal file
documentation of the University of Cincinnati.
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pyuff
from numpy.typing import NDArray

from labdaemon.export.cube import EnvelopeCube
from labdaemon.export.results import FolderResults
from labdaemon.version import __version__

MM = 1e-3
_FREQUENCY, _DISPLACEMENT = 18, 8
"""Specific data types of the format: frequency; displacement."""


def write(results: FolderResults, path: Path) -> None:
    """Write the file."""
    cube = EnvelopeCube.of(results)
    file = pyuff.UFF(str(path))
    file.write_sets([*_geometry(results, cube), *_shapes(cube), *_functions(cube)], mode="overwrite")


def _geometry(results: FolderResults, cube: EnvelopeCube) -> list[dict[str, Any]]:
    now = datetime.now(UTC)
    nodes = np.arange(1, len(cube.targets) + 1)
    mean = cube.vectors["mean_mm"]
    seen = np.isfinite(mean)
    places = MM * np.where(seen, mean, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    ones = np.ones(len(nodes), dtype=int)
    day, time = now.strftime("%d-%b-%y"), now.strftime("%H:%M:%S")
    return [
        pyuff.prepare_151(
            model_name=results.folder.resolve().name[:80],
            description=f"targets {' '.join(cube.targets)}"[:80],
            db_app="labdaemon",
            date_db_created=day,
            time_db_created=time,
            version_db1=0,
            version_db2=0,
            file_type=0,
            date_db_saved=day,
            time_db_saved=time,
            program=f"labdaemon {__version__}",
            date_db_written=day,
            time_db_written=time,
        ),
        pyuff.prepare_164(
            units_code=1,
            units_description="SI: Meter (newton)",
            temp_mode=1,
            length=1.0,
            force=1.0,
            temp=1.0,
            temp_offset=273.15,
        ),
        pyuff.prepare_2411(
            node_nums=nodes, def_cs=ones, disp_cs=ones, color=ones, x=places[:, 0], y=places[:, 1], z=places[:, 2]
        ),
        pyuff.prepare_82(trace_num=1, n_nodes=len(nodes), color=1, id="targets", nodes=nodes),
    ]


def _shapes(cube: EnvelopeCube) -> list[dict[str, Any]]:
    """One operating deflection shape an envelope; targets without numbers are left out."""
    sets = []
    amplitude = MM * cube.complex_amplitude_mm
    for index, capture in enumerate(cube.captures):
        is_measured = np.isfinite(amplitude[index]).all(axis=1)
        if not is_measured.any():
            continue
        u = amplitude[index][is_measured]
        sets.append(
            pyuff.prepare_55(
                id1=capture[:80],
                id2="operating deflection shape, m" if cube.is_phase_known[index] else "amplitude without phase, m",
                id3="NONE",
                id4="NONE",
                id5="NONE",
                model_type=1,
                analysis_type=5,
                data_ch=2,
                spec_data_type=_DISPLACEMENT,
                data_type=5,
                n_data_per_node=3,
                load_case=1,
                freq_step_n=index + 1,
                freq=float(np.nan_to_num(cube.per_capture["frequency_hz"][index])),
                node_nums=np.flatnonzero(is_measured) + 1,
                r1=u[:, 0],
                r2=u[:, 1],
                r3=u[:, 2],
            )
        )
    return sets


def _functions(cube: EnvelopeCube) -> list[dict[str, Any]]:
    """Displacement of each target and direction per displacement of the table, over frequency."""
    frequency, table = cube.per_capture["frequency_hz"], cube.per_capture["table_amplitude_mm"]
    is_driven = np.isfinite(frequency) & np.isfinite(table)
    ratio = cube.frequency_response[is_driven]
    has_phase = bool(cube.is_phase_known[is_driven].all())
    sets = []
    for node, target in enumerate(cube.targets, start=1):
        for direction in (1, 2, 3):
            values = ratio[:, node - 1, direction - 1]
            is_measured = np.isfinite(values)
            x, y = _by_frequency(frequency[is_driven][is_measured], values[is_measured])
            if len(x) < 2:  # one frequency is no function; the shape holds it
                continue
            sets.append(_function(target, node, direction, x, y, has_phase=has_phase))
    return sets


def _by_frequency(
    frequency: NDArray[np.float64], values: NDArray[np.complex128]
) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    """Sort by frequency; the mean of captures at one frequency, as an abscissa must rise."""
    unique, place = np.unique(frequency, return_inverse=True)
    mean = np.zeros(len(unique), dtype=np.complex128)
    np.add.at(mean, place, values)
    return unique, mean / np.bincount(place)


def _function(
    target: str,
    node: int,
    direction: int,
    x: NDArray[np.float64],
    y: NDArray[np.complex128],
    *,
    has_phase: bool,
) -> dict[str, Any]:
    return dict(
        pyuff.prepare_58(
            binary=0,
            id1=f"target {target}"[:80],
            id2="displacement per displacement of the table" + ("" if has_phase else ", amplitude without phase"),
            id3="NONE",
            id4="NONE",
            id5="NONE",
            func_type=4,
            ver_num=1,
            load_case_id=0,
            # A field of ten bytes among others in one line: a longer one moves those behind it.
            rsp_ent_name=target.encode("ascii", "replace")[:10].decode() or "NONE",
            rsp_node=node,
            rsp_dir=direction,
            ref_ent_name="TABLE",
            ref_node=0,
            ref_dir=0,
            abscissa_spacing=0,
            abscissa_spec_data_type=_FREQUENCY,
            abscissa_axis_units_lab="Hz",
            ordinate_spec_data_type=_DISPLACEMENT,
            ordinate_axis_units_lab="m",
            orddenom_spec_data_type=_DISPLACEMENT,
            orddenom_axis_units_lab="m",
            data=y,
            x=x,
        )
    )
