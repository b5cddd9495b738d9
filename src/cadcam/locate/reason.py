"""Why a pose is believed, or why not: kept in parts, for later steps exchange some and add others."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum


class Refusal(Enum):
    """How a pose is refused."""

    NOT_FOUND = "not found"  # the photos do not show the part there
    NOT_CERTAIN = "not certain"  # its lines are shown, but something else speaks against it


@dataclass(frozen=True, slots=True)
class Reason:
    """Why a pose is believed or refused, as one line of text: `str` of it.

    why: what speaks for the pose, or against it where it is refused. refusal: how it is; None where it is believed.
    known: how well the pose is known (`weakest_direction`), "" where that is not said. notes: what else is to be said,
    in this order. of: the reason that the pose had before it was refused. around_start: whether the part was looked for
    around the start alone. off_plane: whether the pose is refused for not lying on the plane that was stated.
    """

    why: str
    refusal: Refusal | None = None
    known: str = ""
    notes: tuple[str, ...] = ()
    of: Reason | None = None
    around_start: bool = False
    off_plane: bool = False

    def __str__(self) -> str:
        """Return it in one line."""
        return f"{self.refusal.value}: {self.bare}" if self.refusal else self.bare

    @property
    def bare(self) -> str:
        """Return it in one line that does not begin with how the pose is refused."""
        why = f"{self.why} ({self.of})" if self.of else self.why
        return "; ".join(filter(None, (why, self.known, *self.notes)))

    def noting(self, note: str) -> Reason:
        """Return it with one more note."""
        return replace(self, notes=(*self.notes, note))

    def knowing(self, known: str) -> Reason:
        """Return it with how well the pose is known after all, if it says how well."""
        if self.of:
            return replace(self, of=self.of.knowing(known))
        return replace(self, known=known) if self.known else self

    def refused(self, refusal: Refusal, why: str, *, off_plane: bool = False) -> Reason:
        """Return why the pose is refused whatever spoke for it."""
        return Reason(why, refusal, of=self, off_plane=off_plane)
