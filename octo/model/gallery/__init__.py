"""Six characters built from code: capsules of one density, x forward, y left, z up."""

from collections.abc import Callable

from octo.model.character import Character
from octo.model.gallery.chain import chain
from octo.model.gallery.four_legs import mammal, spider
from octo.model.gallery.humanoid import humanoid
from octo.model.gallery.two_legs import biped, bird

CHARACTERS: dict[str, Callable[[], Character]] = {
    "chain": chain,
    "biped": biped,
    "bird": bird,
    "mammal": mammal,
    "spider": spider,
    "humanoid": humanoid,
}

__all__ = ["CHARACTERS", "biped", "bird", "chain", "humanoid", "mammal", "spider"]
