"""Small networks of OpenPCDet and mmdetection3d for tests, in PyTorch: their layers have the kits' names and shapes.

No weights of either kit are here: these are random. What the layers do is written anew, from the papers and the kits'
documents, as plainly as it can be.
"""

import math
from copy import deepcopy
from typing import Any

import numpy as np
import torch
import yaml
from torch import nn

from lidcam.pipeline.core.arrays import F64

RANGE = [0.0, -4.0, -3.0, 8.0, 4.0, 1.0]
CELL = [0.5, 0.5, 4.0]
MOST = 4
CLASSES = ["Car", "Pedestrian"]
SIZES = [[3.9, 1.6, 1.56], [0.8, 0.6, 1.73]]
BOTTOMS = [-1.78, -0.6]
TASKS = [["car"], ["pedestrian", "bus"]]
BRANCHES = (2, 1, 3, 2)

OPENPCDET: dict[str, Any] = yaml.safe_load("""
CLASS_NAMES: [Car, Pedestrian]
DATA_CONFIG:
  DATASET: KittiDataset
  POINT_CLOUD_RANGE: [0.0, -4.0, -3.0, 8.0, 4.0, 1.0]
  POINT_FEATURE_ENCODING: {used_feature_list: [x, y, z, intensity]}
  DATA_PROCESSOR:
    - {NAME: shuffle_points}
    - {NAME: transform_points_to_voxels, VOXEL_SIZE: [0.5, 0.5, 4.0], MAX_POINTS_PER_VOXEL: 4}
MODEL:
  NAME: PointPillar
  VFE: {NAME: PillarVFE, WITH_DISTANCE: false, USE_ABSLOTE_XYZ: true, USE_NORM: true, NUM_FILTERS: [8, 8]}
  MAP_TO_BEV: {NAME: PointPillarScatter, NUM_BEV_FEATURES: 8}
  BACKBONE_2D: {NAME: BaseBEVBackbone, LAYER_NUMS: [1, 2], LAYER_STRIDES: [2, 2], NUM_FILTERS: [8, 12],
    UPSAMPLE_STRIDES: [1, 2], NUM_UPSAMPLE_FILTERS: [4, 6]}
  DENSE_HEAD: {NAME: AnchorHeadSingle, CLASS_AGNOSTIC: false, USE_DIRECTION_CLASSIFIER: true, DIR_OFFSET: 0.78539,
    DIR_LIMIT_OFFSET: 0.0, NUM_DIR_BINS: 2, TARGET_ASSIGNER_CONFIG: {BOX_CODER: ResidualCoder}}
""")
OPENPCDET["MODEL"]["DENSE_HEAD"]["ANCHOR_GENERATOR_CONFIG"] = [
    {"class_name": name, "anchor_sizes": [size], "anchor_bottom_heights": [bottom], "anchor_rotations": [0, 1.57]}
    | {"align_center": False, "feature_map_stride": 2}
    for name, size, bottom in zip(CLASSES, SIZES, BOTTOMS, strict=True)
]
OPENPCDET_CENTERS = deepcopy(OPENPCDET) | {"CLASS_NAMES": ["car", "pedestrian", "bus"]}
OPENPCDET_CENTERS["MODEL"] |= yaml.safe_load("""
NAME: CenterPoint
DENSE_HEAD:
  {NAME: CenterHead, CLASS_AGNOSTIC: false, CLASS_NAMES_EACH_HEAD: [[car], [pedestrian, bus]], SHARED_CONV_CHANNEL: 8,
    USE_BIAS_BEFORE_NORM: true, NUM_HM_CONV: 2, TARGET_ASSIGNER_CONFIG: {FEATURE_MAP_STRIDE: 2},
    POST_PROCESSING: {SCORE_THRESH: 0.1}}
""")
OPENPCDET_CENTERS["MODEL"]["DENSE_HEAD"]["SEPARATE_HEAD_CFG"] = {
    "HEAD_DICT": {
        name: {"out_channels": count, "num_conv": 2}
        for name, count in zip(("center", "center_z", "dim", "rot", "vel"), (*BRANCHES, 2), strict=True)
    }
}
MMDET3D: dict[str, Any] = yaml.safe_load("""
dataset_type: KittiDataset
class_names: [Car, Pedestrian]
model:
  type: VoxelNet
  data_preprocessor:
    type: Det3DDataPreprocessor
    voxel_layer:
      {max_num_points: 4, point_cloud_range: &range [0.0, -4.0, -3.0, 8.0, 4.0, 1.0], voxel_size: &cell [0.5, 0.5, 4.0]}
  voxel_encoder:
    {type: PillarFeatureNet, in_channels: 4, feat_channels: [8, 8], voxel_size: *cell, point_cloud_range: *range}
  middle_encoder: {type: PointPillarsScatter, in_channels: 8, output_shape: [16, 16]}
  backbone: {type: SECOND, in_channels: 8, layer_nums: [1, 2], layer_strides: [2, 2], out_channels: [8, 12]}
  neck: {type: SECONDFPN, in_channels: [8, 12], upsample_strides: [1, 2], out_channels: [4, 6]}
  bbox_head:
    type: Anchor3DHead
    num_classes: 2
    anchor_generator:
      type: AlignedAnchor3DRangeGenerator
      ranges: [[0, -4.0, -1.78, 8.0, 4.0, -1.78], [0, -4.0, -0.6, 8.0, 4.0, -0.6]]
      sizes: [[3.9, 1.6, 1.56], [0.8, 0.6, 1.73]]
      rotations: [0, 1.57]
    bbox_coder: {type: DeltaXYZWLHRBBoxCoder}
    loss_cls: {type: mmdet.FocalLoss, use_sigmoid: true}
  train_cfg: {code_weight: 1.0}
  test_cfg: {nms_pre: 100}
""")
MMDET3D_CENTERS = deepcopy(MMDET3D)
_PTS = {f"pts_{key}": part for key, part in MMDET3D_CENTERS["model"].items() if isinstance(part, dict)}
MMDET3D_CENTERS["model"] = {
    "type": "CenterPoint",
    "data_preprocessor": _PTS["pts_data_preprocessor"],
    **{key: _PTS[key] for key in ("pts_voxel_encoder", "pts_middle_encoder", "pts_backbone", "pts_neck")},
    "pts_bbox_head": {
        "type": "CenterHead",
        "in_channels": 10,
        "tasks": [{"num_class": len(task), "class_names": task} for task in TASKS],
        "common_heads": dict(zip(("reg", "height", "dim", "rot"), ([one, 2] for one in BRANCHES), strict=True)),
        "share_conv_channel": 8,
        "bbox_coder": {
            "type": "CenterPointBBoxCoder",
            "pc_range": RANGE[:2],
            "out_size_factor": 2,
            "voxel_size": CELL[:2],
        },
        "separate_head": {"type": "SeparateHead", "init_bias": -2.19, "final_kernel": 3},
    },
}
MMDET3D_CENTERS["model"]["pts_voxel_encoder"] |= {"legacy": False, "in_channels": 5}
MMDET3D_CENTERS["model"]["pts_neck"] |= {"upsample_strides": [0.5, 1], "use_conv_for_no_stride": True}
MMDET3D_CENTERS["model"]["pts_bbox_head"]["bbox_coder"]["out_size_factor"] = 4
CONFIGS = {
    "OpenPCDet, anchors": OPENPCDET,
    "OpenPCDet, centres": OPENPCDET_CENTERS,
    "mmdetection3d, anchors": MMDET3D,
    "mmdetection3d, centres": MMDET3D_CENTERS,
}


class KitNet:
    """A network of random weights.

    Attributes:
        config: Its configuration.
        layers: By their names.
    """

    def __init__(self, name: str) -> None:
        torch.manual_seed(0)
        self.config, self.layers = CONFIGS[name], dict[str, nn.Module]()
        self._is_pcdet, self._has_anchors = name.startswith("O"), name.endswith("anchors")
        pts = "" if self._has_anchors else "pts_"
        self._vfe, self._blocks, self._ups, self._head, self._first = (
            ("vfe", "backbone_2d.blocks", "backbone_2d.deblocks", "dense_head", 1)
            if self._is_pcdet
            else (f"{pts}voxel_encoder", f"{pts}backbone.blocks", f"{pts}neck.deblocks", f"{pts}bbox_head", 0)
        )
        self._shrinks = name == "mmdetection3d, centres"
        self._extra = [0.0] * self._shrinks
        self._make()
        for layer in self.layers.values():
            if isinstance(layer, nn.BatchNorm1d | nn.BatchNorm2d):  # as if it had learned
                assert layer.running_mean is not None
                assert layer.running_var is not None
                layer.running_mean.uniform_(-0.3, 0.3), layer.running_var.uniform_(0.5, 2.0)
                nn.init.uniform_(layer.weight, 0.5, 1.5), nn.init.uniform_(layer.bias, -0.3, 0.3)
            layer.eval()

    @property
    def state(self) -> dict[str, torch.Tensor]:
        """Its weights by name."""
        return {f"{name}.{key}": one for name, layer in self.layers.items() for key, one in layer.state_dict().items()}

    def _make(self) -> None:
        add, inputs = self.layers, 10 + len(self._extra)
        for row, (width, before) in enumerate(((4, inputs), (8, 8))):
            add[f"{self._vfe}.pfn_layers.{row}.linear"] = nn.Linear(before, width, bias=False)
            add[f"{self._vfe}.pfn_layers.{row}.norm"] = nn.BatchNorm1d(width, eps=1e-3)
        ups: tuple[nn.Module, nn.Module] = (nn.Conv2d(8, 4, 2, 2, bias=False), nn.Conv2d(12, 6, 1, bias=False))
        if not self._shrinks:
            ups = (nn.ConvTranspose2d(8, 4, 1, 1, bias=False), nn.ConvTranspose2d(12, 6, 2, 2, bias=False))
        for block, (before, width, layers) in enumerate(((8, 8, 2), (8, 12, 3))):
            for layer in range(layers):
                place = self._first + 3 * layer
                conv = nn.Conv2d(width if layer else before, width, 3, 1 if layer else 2, padding=1, bias=False)
                add[f"{self._blocks}.{block}.{place}"] = conv
                add[f"{self._blocks}.{block}.{place + 1}"] = nn.BatchNorm2d(width, eps=1e-3)
            add[f"{self._ups}.{block}.0"] = ups[block]
            add[f"{self._ups}.{block}.1"] = nn.BatchNorm2d((4, 6)[block], eps=1e-3)
        if self._has_anchors:
            boxes = "conv_box" if self._is_pcdet else "conv_reg"
            for layer_name, count in (("conv_cls", 2), (boxes, 7), ("conv_dir_cls", 2)):
                add[f"{self._head}.{layer_name}"] = nn.Conv2d(10, 4 * count, 1)
            return
        conv_name, norm_name, heads = ("0", "1", "heads_list") if self._is_pcdet else ("conv", "bn", "task_heads")
        width = 8 if self._is_pcdet else 64
        add[f"{self._head}.shared_conv.{conv_name}"] = nn.Conv2d(10, 8, 3, padding=1, bias=self._is_pcdet)
        add[f"{self._head}.shared_conv.{norm_name}"] = nn.BatchNorm2d(8)
        for task, classes in enumerate(TASKS):
            for branch, count in self._branches(len(classes)).items():
                name = f"{self._head}.{heads}.{task}.{branch}"
                add[f"{name}.0.{conv_name}"] = nn.Conv2d(8, width, 3, padding=1, bias=self._is_pcdet)
                add[f"{name}.0.{norm_name}"] = nn.BatchNorm2d(width)
                add[f"{name}.1"] = nn.Conv2d(width, count, 3, padding=1)

    def _branches(self, classes: int) -> dict[str, int]:
        names = ("center", "center_z", "dim", "rot") if self._is_pcdet else ("reg", "height", "dim", "rot")
        heat = {"hm" if self._is_pcdet else "heatmap": classes}
        return heat | dict(zip(names, BRANCHES, strict=True)) | ({"vel": 2} if self._is_pcdet else {})

    def _run(self, x: torch.Tensor, *names: str) -> torch.Tensor:
        for name in names:
            x = self.layers[name](x)
        return torch.relu(x)

    def boxes(self, points: F64) -> tuple[F64, F64]:
        """All boxes (N, 7), of centres and headings in the kit's frame, and log odds (N, C), -30 of others, of points
        (P, 4) of which no pillar has more than `MOST`."""
        with torch.no_grad():
            image = self._image(torch.from_numpy(points.astype(np.float32)))
            parts = []
            for block, layers in enumerate((2, 3)):
                for layer in range(layers):
                    place = self._first + 3 * layer
                    image = self._run(image, f"{self._blocks}.{block}.{place}", f"{self._blocks}.{block}.{place + 1}")
                parts.append(self._run(image, f"{self._ups}.{block}.0", f"{self._ups}.{block}.1"))
            image = torch.cat(parts, 1)
            return self._anchor_boxes(image) if self._has_anchors else self._center_boxes(image)

    def _image(self, points: torch.Tensor) -> torch.Tensor:
        image = torch.zeros(1, 8, 16, 16)
        cells = torch.floor((points[:, :2] - torch.tensor(RANGE[:2])) / CELL[0]).long()
        for column, row in {tuple(one) for one in cells.tolist()}:
            own = points[(cells == torch.tensor([column, row])).all(1)]
            middle = torch.tensor([(column + 0.5) * CELL[0], (row + 0.5) * CELL[1] + RANGE[1], -1.0])
            raw = torch.cat([own, torch.zeros(len(own), len(self._extra))], 1)
            if self.config is MMDET3D:  # "legacy"
                raw = torch.cat([own[:, :3] - middle, own[:, 3:]], 1)
            told = torch.zeros(MOST, 10 + len(self._extra))
            told[: len(own)] = torch.cat([raw, own[:, :3] - own[:, :3].mean(0), own[:, :3] - middle], 1)
            for layer in range(2):
                name = f"{self._vfe}.pfn_layers.{layer}"
                told = self._run(told, f"{name}.linear", f"{name}.norm")
                highest = told.max(0, keepdim=True)[0]
                told = torch.cat([told, highest.expand_as(told)], 1)
            image[0, :, row, column] = highest[0]
        return image

    def _by_cell(self, image: torch.Tensor, numbers: int) -> F64:
        return np.asarray(image[0].permute(1, 2, 0).reshape(-1, numbers).double().numpy())

    def _anchor_boxes(self, image: torch.Tensor) -> tuple[F64, F64]:
        boxes = "conv_box" if self._is_pcdet else "conv_reg"
        odds, numbers, turns = (
            self._by_cell(self.layers[f"{self._head}.{name}"](image), count)
            for name, count in (("conv_cls", 2), (boxes, 7), ("conv_dir_cls", 2))
        )
        found, offset = [], 0.78539 if self._is_pcdet else -math.pi / 2
        for index, (one, turn) in enumerate(zip(numbers, turns, strict=True)):
            (row, column), anchor = divmod(index // 4, 8), index % 4
            x, y = (column / 7 * 8, row / 7 * 8 - 4) if self._is_pcdet else (column + 0.5, row - 3.5)
            length, width, height = SIZES[anchor // 2]
            diagonal, z = math.hypot(length, width), BOTTOMS[anchor // 2] + height / 2
            yaw = one[6] + (0, 1.57)[anchor % 2] - offset
            yaw = yaw - math.floor(yaw / math.pi) * math.pi + offset + math.pi * turn.argmax()
            center = x + one[0] * diagonal, y + one[1] * diagonal, z + one[2] * height
            found.append([*center, *(np.exp(one[3:6]) * SIZES[anchor // 2]), yaw])
        return np.array(found), odds

    def _center_boxes(self, image: torch.Tensor) -> tuple[F64, F64]:
        conv, norm, heads = ("0", "1", "heads_list") if self._is_pcdet else ("conv", "bn", "task_heads")
        image = self._run(image, f"{self._head}.shared_conv.{conv}", f"{self._head}.shared_conv.{norm}")
        found, odds, before = [], [], 0
        for task, classes in enumerate(TASKS):
            said = {}
            for branch, count in self._branches(len(classes)).items():
                name = f"{self._head}.{heads}.{task}.{branch}"
                hidden = self._run(image, f"{name}.0.{conv}", f"{name}.0.{norm}")
                said[branch] = self._by_cell(self.layers[f"{name}.1"](hidden), count)
            heat, place, z, size, turn, *_ = said.values()
            side, step = image.shape[3], 8.0 / image.shape[3]
            cell = np.arange(len(z))
            x, y = (cell % side + place[:, 0]) * step, (cell // side + place[:, 1]) * step - 4
            sine, cosine = turn.T[::-1] if self._is_pcdet else turn.T
            found.append(np.column_stack([x, y, z, np.exp(size), np.arctan2(sine, cosine)]))
            own = np.full((len(z), 3), -30.0)
            own[:, before : before + len(classes)] = heat
            odds.append(own)
            before += len(classes)
        return np.concatenate(found), np.concatenate(odds)
