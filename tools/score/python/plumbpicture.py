"""Curves over one another as SVG, which a notebook shows. Needs numpy alone.

Input: curves by their names, each as two arrays. Output: the drawing. Time: none. Failure: what is `nan` is left out, and curves
of which nothing is known are refused.
"""

from __future__ import annotations

from html import escape
from typing import Any, Mapping

import numpy as np
from numpy.typing import NDArray

Curve = tuple[NDArray[Any], NDArray[Any]]

WIDTH, HEIGHT = 640, 320
LEFT, RIGHT, TOP, BOTTOM = 70, 620, 20, 270
COLORS = ("#CC79A7", "#E69F00", "#0072B2", "#000000")
# A curve has no more points than pixels across.
POINTS_MAX = 550


class Picture:
    """The drawing; `text` is its SVG."""

    def __init__(self, curves: Mapping[str, Curve], across: str, up: str):
        known = {name: [axis[np.isfinite(x) & np.isfinite(y)] for axis in (x, y)] for name, (x, y) in curves.items()}
        if not any(x.size for x, _ in known.values()):
            raise ValueError(f"drawing {', '.join(curves) or 'no curve'}: nothing is known of it; look whether there is a truth")
        (left, right), (low, high) = [_range(np.concatenate(axis)) for axis in zip(*known.values())]
        parts = [f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{HEIGHT}" style="font: 12px sans-serif">']
        parts.append(f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>')
        parts.append(f'<path d="M{LEFT} {TOP}V{BOTTOM}H{RIGHT}" fill="none" stroke="gray"/>')
        for at, (name, (x, y)) in enumerate(known.items()):
            step, color = max(1, -(-x.size // POINTS_MAX)), COLORS[at % len(COLORS)]
            place_x = LEFT + (x[::step] - left) / (right - left) * (RIGHT - LEFT)
            place_y = BOTTOM - (y[::step] - low) / (high - low) * (BOTTOM - TOP)
            points = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(place_x, place_y))
            parts.append(f'<polyline points="{points}" fill="none" stroke="{color}"/>')
            parts.append(_said(LEFT + 10 + 135 * at, TOP + 12, name, color=color))
        parts += [_said(LEFT, BOTTOM + 16, f"{left:.4g}"), _said(RIGHT, BOTTOM + 16, f"{right:.4g}", "end")]
        parts += [_said(LEFT - 6, BOTTOM, f"{low:.3g}", "end"), _said(LEFT - 6, TOP + 10, f"{high:.3g}", "end")]
        parts += [_said((LEFT + RIGHT) // 2, BOTTOM + 36, across, "middle"), _said(LEFT, TOP - 6, up)]
        self.text = "\n".join([*parts, "</svg>\n"])

    def _repr_svg_(self) -> str:
        return self.text


def _range(of: NDArray[Any]) -> tuple[float, float]:
    low, high = float(of.min()), float(of.max())
    return (low, high) if low < high else (low - 0.5, high + 0.5)


def _said(x: int, y: int, text: str, anchor: str = "start", color: str = "black") -> str:
    return f'<text x="{x}" y="{y}" text-anchor="{anchor}" fill="{color}">{escape(text)}</text>'
