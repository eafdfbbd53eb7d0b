"""What a character is, as plain lists and numbers."""

from __future__ import annotations

from typing import Any

from octo.model.character import Character


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
