"""Configurations of OpenPCDet (github.com/open-mmlab/OpenPCDet, tools/cfgs)."""

from typing import Any

from lidcam.training.kits import model as kit

NAMES = kit.Names(
    encoder="vfe.pfn_layers",
    blocks="backbone_2d.blocks",
    ups="backbone_2d.deblocks",
    head="dense_head",
    first=1,
    boxes="conv_box",
    heads="heads_list",
    pair=("0", "1"),
    heat="hm",
    branches=("center", "center_z", "dim", "rot"),
)
PARTS = {
    "VFE": ("PillarVFE", "DynPillarVFE"),
    "MAP_TO_BEV": ("PointPillarScatter",),
    "BACKBONE_2D": ("BaseBEVBackbone",),
    "DENSE_HEAD": ("AnchorHeadSingle", "CenterHead"),
}


def openpcdet_model(config: dict[str, Any], given: kit.Data) -> kit.KitModel:
    """The network of a configuration.

    Raises ModelError if it is not in pillars, or has other parts, and LookupError, TypeError or ValueError if a value
    is missing or unexpected.
    """
    model, data, names = config["MODEL"], config["DATA_CONFIG"], config["CLASS_NAMES"]
    parts = {key: part["NAME"] for key, part in model.items() if isinstance(part, dict) and "NAME" in part}
    kit.check_parts(model["NAME"], parts, PARTS)
    vfe, backbone, head = model["VFE"], model["BACKBONE_2D"], model["DENSE_HEAD"]
    kit.check(vfe["USE_NORM"], True, "VFE.USE_NORM")
    kit.check(head["CLASS_AGNOSTIC"], False, "DENSE_HEAD.CLASS_AGNOSTIC")
    voxels, limits = data["DATA_PROCESSOR"][-1], data["POINT_CLOUD_RANGE"]
    raw = kit.raw_features(data["POINT_FEATURE_ENCODING"]["used_feature_list"])
    features = (raw if vfe["USE_ABSLOTE_XYZ"] else raw[3:]) + kit.OFFSETS
    if vfe["WITH_DISTANCE"]:
        features.append("distance")
    most = voxels["MAX_POINTS_PER_VOXEL"] if vfe["NAME"] == "PillarVFE" else 0
    made = _anchors(head, limits) if head["NAME"] == "AnchorHeadSingle" else _centers(head, names)
    return kit.KitModel(
        names=NAMES,
        specs=kit.specs_of(names, made, limits, voxels["VOXEL_SIZE"], features, most, data.get("DATASET"), given),
        encoder=kit.Encoder(channels=vfe["NUM_FILTERS"]),
        backbone=kit.Backbone(
            channels=backbone["NUM_FILTERS"],
            layers=backbone["LAYER_NUMS"],
            strides=backbone["LAYER_STRIDES"],
            up_channels=backbone["NUM_UPSAMPLE_FILTERS"],
            up_strides=backbone["UPSAMPLE_STRIDES"],
            convolves=backbone.get("USE_CONV_FOR_NO_STRIDE", False),
        ),
        head=made,
    )


def _anchors(head: dict[str, Any], limits: list[float]) -> kit.AnchorHead:
    kit.check(
        head["TARGET_ASSIGNER_CONFIG"]["BOX_CODER"], "ResidualCoder", "DENSE_HEAD.TARGET_ASSIGNER_CONFIG.BOX_CODER"
    )
    coder = head["TARGET_ASSIGNER_CONFIG"].get("BOX_CODER_CONFIG", {})
    kit.check(coder.get("encode_angle_by_sincos", False), False, "BOX_CODER_CONFIG.encode_angle_by_sincos")
    anchors = []
    for one in head["ANCHOR_GENERATOR_CONFIG"]:
        (bottom,) = one["anchor_bottom_heights"]
        anchors += [
            kit.Anchor(
                low_m=limits[:2],
                high_m=limits[3:5],
                is_centred=one.get("align_center", False),
                z_m=bottom + size[2] / 2,
                size_m=size,
                yaw_rad=yaw,
            )
            for size in one["anchor_sizes"]
            for yaw in one["anchor_rotations"]
        ]
    return kit.AnchorHead(
        anchors=anchors,
        code=coder.get("code_size", 7),
        directions=head["NUM_DIR_BINS"] if head.get("USE_DIRECTION_CLASSIFIER") is not None else 0,
        offset_rad=head.get("DIR_OFFSET", 0.0),
        limit=head.get("DIR_LIMIT_OFFSET", 0.0),
    )


def _centers(head: dict[str, Any], names: list[str]) -> kit.CenterHead:
    post = head["POST_PROCESSING"]
    kit.check(post.get("USE_IOU_TO_RECTIFY_SCORE", False), False, "DENSE_HEAD.POST_PROCESSING.USE_IOU_TO_RECTIFY_SCORE")
    branches = head["SEPARATE_HEAD_CFG"]["HEAD_DICT"]
    return kit.CenterHead(
        tasks=[[name for name in task if name in names] for task in head["CLASS_NAMES_EACH_HEAD"]],
        shared=head["SHARED_CONV_CHANNEL"],
        width=head["SHARED_CONV_CHANNEL"],
        kernel=3,
        heat_layers=head["NUM_HM_CONV"],
        branches={name: (one["out_channels"], one["num_conv"]) for name, one in branches.items()},
        has_bias=head.get("USE_BIAS_BEFORE_NORM", False),
        sine_first=False,
        eps=head.get("BN_EPS", 1e-5),
        stride=head["TARGET_ASSIGNER_CONFIG"]["FEATURE_MAP_STRIDE"],
    )
