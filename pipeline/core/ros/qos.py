"""Quality of service of latched topics such as /tf_static: a late subscriber still gets the last message."""

from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

_FOREVER = QosTime(2147483647, 4294967295)

LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    _FOREVER,
    _FOREVER,
    QosLiveliness.AUTOMATIC,
    _FOREVER,
    avoid_ros_namespace_conventions=False,
)

# The form of rosbag2 since Iron.
_YAML = """\
- history: keep_last
  depth: 1
  reliability: reliable
  durability: transient_local
  deadline: {deadline}
  lifespan: {others}
  liveliness: automatic
  liveliness_lease_duration: {others}
  avoid_ros_namespace_conventions: false
"""
_FOREVER_YAML = "{sec: 9223372036, nsec: 854775807}"

LATCHED_YAML = _YAML.format(deadline=_FOREVER_YAML, others=_FOREVER_YAML)
"""For an MCAP channel's `offered_qos_profiles`; channels without a profile leave it empty."""

LATCHED_YAML_HUMBLE = _YAML.format(
    deadline=f"&id001\n    sec: {_FOREVER.sec}\n    nsec: {_FOREVER.nsec}", others="*id001"
)
"""The same with Humble's infinity, byte for byte as in the sample recordings."""
