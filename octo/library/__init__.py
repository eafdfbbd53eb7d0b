"""Many motions of one structure: solved as batches in many processes, kept in one file, found
again by what was asked of them."""

from octo.library.collection import Library
from octo.library.run import library

__all__ = ["Library", "library"]
