"""Errors come whole from another process: their kind, their words, what they carry."""

from __future__ import annotations

import pickle

import pytest

from cadcam import errors

MADE = (
    errors.BadValue("size", 0, "more"),
    errors.UnknownName("view", "isso", ("iso", "top")),
    errors.UnreadableFile("a.png", "is empty", "copy it again"),
    errors.UnwritableFile("a.png", "No space left on device"),
    errors.DegenerateMotions("one axis", ((1.0, 0.0, 0.0),), ()),
    errors.NotEnoughMemory("too large"),
    errors.UnreachableCluster("tcp://a:1", "timed out"),
)


@pytest.mark.parametrize("error", MADE, ids=lambda e: type(e).__name__)
def test_an_error_travels(error: errors.CadcamError) -> None:
    there = pickle.loads(pickle.dumps(error))
    assert type(there) is type(error)
    assert str(there) == str(error)
    assert there.__dict__ == error.__dict__
