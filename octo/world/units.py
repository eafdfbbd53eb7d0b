"""Whether a map or a mesh is in metres: said by its size."""

from __future__ import annotations

from collections.abc import Iterable

from octo.errors import ValueRangeError

SMALLEST, LARGEST = 0.05, 200.0  # m, of a shape's longest edge
# metres of what shapes are drawn in: millimetres, centimetres, inches, feet, micrometres; and what
# was taken for one of them and was not
FACTORS = (1e-3, 1e-2, 0.0254, 0.3048, 1e-6, 1e3, 1e2, 1e6)


def check_size(
    label: str,
    spans: Iterable[float],
    scale: float,
    limits: tuple[float, float] = (SMALLEST, LARGEST),
) -> None:
    """Refuse what is too large or too small for a robot's world, with the scale that would make it
    fit.

    Parameters
    ----------
    spans: m, of a box around it, scaled.
    scale: that it was scaled by.
    limits: m, of the longest edge.
    """
    size = [float(span) for span in spans]
    longest, (smallest, largest) = max(size), limits
    if smallest <= longest <= largest:
        return
    large = longest > largest
    limit = f"larger than {largest:g} m" if large else f"smaller than {100.0 * smallest:g} cm"
    fits = [f for f in FACTORS if smallest <= f * longest <= largest and (f < 1.0) == large]
    advice = f"; scale={scale * fits[0]:g} makes it {fits[0] * longest:.3g} m long" if fits else ""
    raise ValueRangeError(
        f"{label} is {' × '.join(f'{span:.3g}' for span in size)} m, {limit}: it must be in "
        f"metres{advice}"
    )
