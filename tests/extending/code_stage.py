"""A stage that is code: a smooth height in a table, and a term that holds a point above it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

import octo

SPACING = 0.1  # m
HEIGHTS = 0.05 * np.random.default_rng(3).random((16, 16))  # m, about the world's origin

TEXT = f"""
#define grid_spacing {SPACING}
#define grid_size {len(HEIGHTS)}
{octo.CodeStage.table("grid_heights", HEIGHTS)}
/* A quadratic spline over the 3 by 3 heights next to (x, y); its edge goes on without an end. */
static void grid(const double *a, double *value, double *slopes) {{
  double sum[3] = {{0.0, 0.0, 0.0}}, w[2][3], dw[2][3];
  int first[2];
  for (int k = 0; k < 2; ++k) {{
    double at = a[k] / grid_spacing + 0.5 * grid_size;
    double cell = fmin(fmax(floor(at), 1.0), grid_size - 2.0), t = fmin(fmax(at - cell, 0.0), 1.0);
    double slope = t == at - cell ? 1.0 / grid_spacing : 0.0;
    first[k] = (int)cell - 1;
    w[k][0] = 0.5 * (1.0 - t) * (1.0 - t), w[k][1] = 0.5 + t - t * t, w[k][2] = 0.5 * t * t;
    dw[k][0] = (t - 1.0) * slope, dw[k][1] = (1.0 - 2.0 * t) * slope, dw[k][2] = t * slope;
  }}
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {{
      double height = grid_heights[(first[0] + i) * grid_size + first[1] + j];
      sum[0] += w[0][i] * w[1][j] * height;
      sum[1] += dw[0][i] * w[1][j] * height;
      sum[2] += w[0][i] * dw[1][j] * height;
    }}
  value[0] = sum[0];
  if (slopes) slopes[0] = sum[1], slopes[1] = sum[2];
}}
"""


def grid(a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same, a (…, 2)."""
    at = a / SPACING + 0.5 * len(HEIGHTS)
    cell = np.clip(np.floor(at), 1, len(HEIGHTS) - 2)
    t = np.clip(at - cell, 0.0, 1.0)
    slope = (t == at - cell) / SPACING
    w = np.stack([0.5 * (1 - t) ** 2, 0.5 + t - t * t, 0.5 * t * t])  # (3, …, 2)
    dw = np.stack([(t - 1) * slope, (1 - 2 * t) * slope, t * slope])
    first = cell.astype(int) - 1
    three = np.arange(3)
    i, j = first[..., 0, None, None] + three[:, None], first[..., 1, None, None] + three
    parts = [(w[..., 0], w[..., 1]), (dw[..., 0], w[..., 1]), (w[..., 0], dw[..., 1])]
    sums = [np.einsum("i...,j...,...ij->...", x, y, HEIGHTS[i, j]) for x, y in parts]
    return sums[0][..., None], np.stack(sums[1:], axis=-1)[..., None, :]


GRID = octo.CodeStage("grid", inputs=2, outputs=1, text=TEXT, python=grid)


@dataclass(frozen=True, eq=False)
class OverGrid(octo.Cost):
    """A point of a body keeps a height (m) over the grid."""

    body: str = ""
    height: float = 0.02

    def references(self, setting: octo.costs.Setting) -> Mapping[str, np.ndarray]:
        return {"height": np.array([self.height])}

    def residual(self, step: octo.costs.StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        rotation, place = step.pose(self.body)
        point = place + rotation @ ca.DM([0.0, 0.0, -0.2])
        return point[2] - step.call(GRID, point[:2]) - p["height"]
