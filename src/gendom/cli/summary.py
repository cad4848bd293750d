"""What a recording holds, for people and as JSON."""

from typing import Any

import numpy as np

from gendom.datasets import Recording
from gendom.errors import printable


def summarize(recording: Recording) -> dict[str, Any]:
    """What a recording holds, in metres and seconds, ready for JSON."""
    counts = np.diff(recording.offsets)
    used = counts[recording.frame_valid]
    position, held = recording.gripper_position, recording.object
    length = np.linalg.norm(np.diff(position, axis=0), axis=2).sum(axis=0)
    sizes = ("length", "diameter", "width", "height", "thickness")
    return {
        "kind": held.kind,
        "sizes": {n: getattr(held, n) for n in sizes if getattr(held, n) is not None},
        "mass": held.mass,
        "grasp": held.grasp,
        "frames": recording.num_frames,
        "empty_frames": int((counts == 0).sum()),
        "points_per_frame": spread(used),
        "time": {"first": recording.time[0], "last": recording.time[-1]},
        "grippers": [
            {
                "path_length": float(length[g]),
                "rise": float(position[-1, g, 2] - position[0, g, 2]),
                "closed_frames": int(recording.holds[:, g].sum()),
            }
            for g in range(recording.num_grippers)
        ],
        "gripper_source": recording.gripper_source,
        "gripper_axis": recording.gripper_axis is not None,
        "table_height": recording.table_height,
        "quasi_static": recording.quasi_static,
        "source": recording.source,
    }


def spread(counts: np.ndarray) -> dict[str, float]:
    """Least, median and most of some counts."""
    return {"min": int(counts.min()), "median": float(np.median(counts)), "max": int(counts.max())}


def summary_rows(summary: dict[str, Any]) -> dict[str, str]:
    """The same for people, by what it is about."""
    sizes = ", ".join(f"{name} {value:.4g} m" for name, value in summary["sizes"].items())
    mass = "unknown" if summary["mass"] is None else f"{summary['mass']:.4g} kg"
    points, time, table = summary["points_per_frame"], summary["time"], summary["table_height"]
    frames, empty = summary["frames"], summary["empty_frames"]
    grippers = []
    for g in summary["grippers"]:
        said = f"path {g['path_length']:.3g} m, rise {g['rise']:.3g} m"
        shorter = g["closed_frames"] < frames
        grippers.append(said + f", closed in {g['closed_frames']} frames" * shorter)
    return {
        "object": f"{summary['kind']}, {sizes}, mass {mass}, held by: {summary['grasp']}",
        "frames": f"{frames}" + f", {empty} of them empty" * bool(empty),
        "points": f"{points['min']} to {points['max']} a frame, median {points['median']:g}",
        "time": f"{time['first']:.4g} to {time['last']:.4g} s",
        "grippers": f"{len(grippers)} ({summary['gripper_source']}): {'; '.join(grippers)}",
        "table": "none" if table is None else f"at z = {table:.4g} m",
        "motion": "quasi-static" if summary["quasi_static"] else "dynamic",
    }


def rows_text(place: object, said: str, rows: dict[str, str]) -> str:
    """Lines below what is said of a place."""
    lines = [f"  {name:<9} {text}" for name, text in rows.items()]
    return "\n".join([f"{printable(place)}: {said}", *lines])
