"""What a character is, as plain lists and numbers."""

from __future__ import annotations

from typing import Any

from octo.model.character import Character

SHOWN = 4  # meshes named in one sentence


def describe(character: Character) -> dict[str, Any]:
    """Name, sizes, mass (kg) and the names of bodies, contacts and pairs; what its file says and octo does not model."""
    names = [contact.name for contact in character.contacts]
    return {
        "name": character.name,
        "nx": character.nx,
        "nu": character.nu,
        "mass": character.mass,
        "bodies": [body.name for body in character.bodies],
        "contacts": names,
        "pairs": [[names[a], names[b]] for a, b in character.pairs],
        "dropped": list(character.dropped),
    }


def lost_shapes(character: Character) -> str:
    """Which collision meshes could not be read, in one sentence; empty where all could."""
    start = "collision mesh "
    lost = [note.removeprefix(start) for note in character.dropped if note.startswith(start)]
    if not lost:
        return ""
    more = f"; and {len(lost) - SHOWN} more, octo info lists all" if len(lost) > SHOWN else ""
    return f"collision meshes are left out and nothing touches there: {'; '.join(lost[:SHOWN])}{more}"
