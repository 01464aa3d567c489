"""Configurations of mmdetection3d 1.0 and later (github.com/open-mmlab/mmdetection3d, configs)."""

import math
from typing import Any

from lidcam.pipeline.detectors.pillars.kits import Feature
from lidcam.training.kits import model as kit

PARTS = {
    "voxel_encoder": ("PillarFeatureNet",),
    "middle_encoder": ("PointPillarsScatter",),
    "backbone": ("SECOND",),
    "neck": ("SECONDFPN",),
    "bbox_head": ("Anchor3DHead", "CenterHead"),
}
POINT = "x", "y", "z", "intensity", "age or elongation"
NO_PARTS = {"data_preprocessor", "voxel_layer", "train_cfg", "test_cfg", "init_cfg"}


def mmdet3d_model(config: dict[str, Any], given: kit.Data) -> kit.KitModel:
    """The network of a configuration.

    Raises ModelError if it is not in pillars, or has other parts, and LookupError, TypeError or ValueError if a value
    is missing or unexpected.
    """
    model, prefix = config["model"], "pts_" if "pts_voxel_encoder" in config["model"] else ""
    own = {key.removeprefix(prefix): part for key, part in model.items() if isinstance(part, dict)}
    kit.check_parts(model["type"], {key: part["type"] for key, part in own.items() if key not in NO_PARTS}, PARTS)
    encoder, backbone, neck, head = (own[key] for key in ("voxel_encoder", "backbone", "neck", "bbox_head"))
    voxels = own.get("data_preprocessor", own).get("voxel_layer") or own["voxel_layer"]
    limits = voxels["point_cloud_range"]
    kit.check(encoder.get("point_cloud_range"), limits, "voxel_encoder.point_cloud_range")
    made = _anchors(head) if head["type"] == "Anchor3DHead" else _centers(head, limits)
    features, most, data_set = _features(encoder), voxels["max_num_points"], config.get("dataset_type")
    names = config["class_names"] if head["type"] == "Anchor3DHead" else ()
    specs = kit.specs_of(names, made, limits, voxels["voxel_size"], features, most, data_set, given)
    kit.check(list(own["middle_encoder"]["output_shape"]), [*specs.grid.cells[::-1]], "middle_encoder.output_shape")
    return kit.KitModel(
        names=kit.Names(
            encoder=f"{prefix}voxel_encoder.pfn_layers",
            blocks=f"{prefix}backbone.blocks",
            ups=f"{prefix}neck.deblocks",
            head=f"{prefix}bbox_head",
            first=0,
            boxes="conv_reg",
            heads="task_heads",
            pair=("conv", "bn"),
            heat="heatmap",
            branches=("reg", "height", "dim", "rot"),
        ),
        specs=specs,
        encoder=kit.Encoder(channels=encoder["feat_channels"], eps=_eps(encoder, 1e-3)),
        backbone=kit.Backbone(
            channels=backbone["out_channels"],
            layers=backbone["layer_nums"],
            strides=backbone["layer_strides"],
            up_channels=neck["out_channels"],
            up_strides=neck["upsample_strides"],
            convolves=neck.get("use_conv_for_no_stride", False),
            eps=_eps(backbone, 1e-3),
            up_eps=_eps(neck, 1e-3),
        ),
        head=made,
    )


def _features(encoder: dict[str, Any]) -> list[Feature]:
    """Features of the points. With `legacy`, the default, the place in the pillar overwrites the place of a point."""
    kit.check(encoder.get("mode", "max"), "max", "voxel_encoder.mode")
    raw = kit.raw_features(POINT[: encoder["in_channels"]])
    cluster, center = encoder.get("with_cluster_center", True), encoder.get("with_voxel_center", True)
    features: list[Feature] = raw + kit.OFFSETS[:3] * cluster + kit.OFFSETS[3:] * center
    if encoder.get("legacy", True) and center:
        features[:3] = kit.OFFSETS[3:]
        kit.check(encoder.get("with_distance", False), False, "voxel_encoder.with_distance")
    if encoder.get("with_distance", False):
        features.append("distance")
    return features


def _anchors(head: dict[str, Any]) -> kit.AnchorHead:
    anchors, coder = head["anchor_generator"], head["bbox_coder"]
    kit.check(coder["type"], "DeltaXYZWLHRBBoxCoder", "bbox_head.bbox_coder")
    kit.check(head["loss_cls"]["use_sigmoid"], True, "bbox_head.loss_cls.use_sigmoid")
    kit.check(anchors.get("scales", [1]), [1], "bbox_head.anchor_generator.scales")
    kit.check(anchors.get("size_per_range", True), True, "bbox_head.anchor_generator.size_per_range")
    kit.check(anchors.get("align_corner", False), False, "bbox_head.anchor_generator.align_corner")
    is_centred = anchors["type"] == "AlignedAnchor3DRangeGenerator"
    if not is_centred:
        kit.check(anchors["type"], "Anchor3DRangeGenerator", "bbox_head.anchor_generator")
    sizes, ranges = anchors["sizes"], anchors["ranges"]
    ranges = ranges * len(sizes) if len(ranges) == 1 else ranges
    return kit.AnchorHead(
        anchors=[
            kit.Anchor(
                low_m=limits[:2],
                high_m=limits[3:5],
                is_centred=is_centred,
                z_m=((limits[2] + limits[5]) / 2 if is_centred else limits[2]) + size[2] / 2,
                size_m=size,
                yaw_rad=yaw,
            )
            for limits, size in zip(ranges, sizes, strict=True)
            for yaw in anchors.get("rotations", [0, 1.5707963])
        ],
        code=coder.get("code_size", 7),
        directions=2 if head.get("use_direction_classifier", True) else 0,
        offset_rad=head.get("dir_offset", -math.pi / 2),
        limit=head.get("dir_limit_offset", 0.0),
    )


def _centers(head: dict[str, Any], limits: list[float]) -> kit.CenterHead:
    separate, coder = head["separate_head"], head["bbox_coder"]
    kit.check(separate["type"].removeprefix("mmdet."), "SeparateHead", "bbox_head.separate_head")
    kit.check(head.get("norm_bbox", True), True, "bbox_head.norm_bbox")
    kit.check(list(coder["pc_range"][:2]), list(limits[:2]), "bbox_head.bbox_coder.pc_range")
    return kit.CenterHead(
        tasks=[task["class_names"] for task in head["tasks"]],
        shared=head.get("share_conv_channel", 64),
        width=separate.get("head_conv", 64),
        kernel=separate.get("final_kernel", 1),
        heat_layers=head.get("num_heatmap_convs", 2),
        branches=head["common_heads"],
        has_bias=head.get("bias", "auto") is True,
        sine_first=True,
        eps=_eps(head, 1e-5),
        stride=coder["out_size_factor"],
    )


def _eps(part: dict[str, Any], default: float) -> float:
    norm = part.get("norm_cfg", {"type": "BN"})
    if "BN" not in norm["type"]:
        kit.check(norm["type"], "BN", "norm_cfg.type")
    return float(norm.get("eps", default if "norm_cfg" not in part else 1e-5))
