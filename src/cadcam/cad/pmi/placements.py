"""Where an assembly has its components: a STEP file gives the faces of each in coordinates of its own.

Occurrences by ISO 10303-44, their places by ISO 10303-43 (context dependent shape representations).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import TypeVar

import numpy as np

from cadcam.cad.pmi.exchange import Exchange, Parameters, Ref
from cadcam.cad.pmi.faces import placement
from cadcam.errors import CadcamError
from cadcam.geometry.rigid import Rigid

_R = TypeVar("_R")
_MALFORMED = (CadcamError, ArithmeticError, AttributeError, LookupError, TypeError, ValueError)


class Placements:
    """The places of components (product definitions, by number) in a file whose lengths are so many mm.

    A place that cannot be understood is as if the assembly did not move the component.
    """

    def __init__(self, file: Exchange, mm: float) -> None:
        self._file, self._mm = file, mm
        self._shown = set(self._each("SHAPE_DEFINITION_REPRESENTATION", self._representation))
        self._within: defaultdict[int, list[tuple[int, Rigid]]] = defaultdict(list)
        for component, assembly, pose in self._each("CONTEXT_DEPENDENT_SHAPE_REPRESENTATION", self._occurrence):
            self._within[component].append((assembly, pose))

    def of(self, component: int, *, parts: tuple[int, ...] = ()) -> list[Rigid]:
        """Return where the file's outermost assembly has each occurrence of a component: whole_from_component, mm.

        parts: of it, in which it cannot be.
        """
        parts = (*parts, component)
        within = [(assembly, pose) for assembly, pose in self._within.get(component, ()) if assembly not in parts]
        return [outer @ pose for assembly, pose in within for outer in self.of(assembly, parts=parts)] or [Rigid()]

    def _each(self, keyword: str, read: Callable[[Parameters], _R]) -> Iterator[_R]:
        for number in self._file.having(keyword):
            try:
                yield read(self._file[number][keyword])
            except _MALFORMED:
                continue

    def _representation(self, parameters: Parameters) -> tuple[int, int]:
        """Return a component, or what else has a shape, and what represents it."""
        shape, representation = parameters[:2]
        return int(self._file[shape]["PRODUCT_DEFINITION_SHAPE"][2]), int(representation)

    def _occurrence(self, parameters: Parameters) -> tuple[int, int, Rigid]:
        """Return a component, the assembly it is in, and assembly_from_component."""
        relation, shape = parameters[:2]
        usage = self._file[self._file[shape]["PRODUCT_DEFINITION_SHAPE"][2]]["NEXT_ASSEMBLY_USAGE_OCCURRENCE"]
        assembly, component = usage[3:5]
        entity = self._file[relation]
        first = entity["REPRESENTATION_RELATIONSHIP"][2]
        transformation = self._file[entity["REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION"][0]]
        one, other = (self._frame(item) for item in transformation["ITEM_DEFINED_TRANSFORMATION"][2:4])
        pose = other @ one.inv
        # some systems write the assembly first
        turned = (assembly, first) in self._shown and (component, first) not in self._shown
        return int(component), int(assembly), pose.inv if turned else pose

    def _frame(self, item: Ref) -> Rigid:
        origin, axes = placement(self._file, item)
        return Rigid.from_matrix(np.column_stack([axes, origin * self._mm]))
