"""The files of a data set, and the map from numbers of views to BOP's scenes and pictures.

dataset.json                       the plan it was made from, with hashes of its inputs
camera.json                        BOP: the internals
models/obj_000001.ply              BOP: the part, mm; models_info.json: its size and diameter
models/obj_000001_edges.npz        the part's edges in space, by the numbers that the labels use
SPLIT/000000/                      BOP: a scene, a thousand views
rgb|gray/000000.png  depth/  mask/000000_000000.png  mask_visib/  normal/  edges/000000.npz
view/000000.json               all else that is known of a view; written last: what has one is done
scene_camera.json  scene_gt.json  scene_gt_info.json
SPLIT_coco.json                    COCO: boxes, masks and key points of all views
contact.png                        some of the views with their labels drawn
"""

from __future__ import annotations

from dataclasses import dataclass

VIEWS_A_SCENE = 1000
OBJECT = 1  # BOP's and COCO's number of the part
LABELS = ("depth", "normal", "mask", "mask_visib", "edges")  # the folders beside the picture's own and view/

DATASET, CAMERA, CONTACT = "dataset.json", "camera.json", "contact.png"
MODEL, MODEL_EDGES, MODELS_INFO = (
    f"models/obj_{OBJECT:06d}.ply",
    f"models/obj_{OBJECT:06d}_edges.npz",
    "models/models_info.json",
)


@dataclass(frozen=True, slots=True)
class DatasetFiles:
    """The names of a data set's files, relative to its folder; `picture` is the folder of pictures: rgb or gray."""

    split: str
    picture: str

    @property
    def coco(self) -> str:
        """Return the COCO file of all views."""
        return f"{self.split}_coco.json"

    def scene(self, scene: int) -> str:
        """Return the folder of a scene."""
        return f"{self.split}/{scene:06d}"

    def path(self, kind: str, index: int) -> str:
        """Return the file of a view: `kind` is the picture's folder, one of LABELS, or "view"."""
        scene, image = divmod(index, VIEWS_A_SCENE)
        tail = {"mask": "_000000.png", "mask_visib": "_000000.png", "edges": ".npz", "view": ".json"}.get(kind, ".png")
        return f"{self.scene(scene)}/{kind}/{image:06d}{tail}"

    def kinds(self) -> tuple[str, ...]:
        """Return the kinds of files a view has, the one that says it is done last."""
        return (self.picture, *LABELS, "view")
