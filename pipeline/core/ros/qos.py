"""Quality of service of latched topics such as /tf_static: a late subscriber still gets the last message."""

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

LATCHED_YAML_HUMBLE = _YAML.format(deadline="&id001\n    sec: 2147483647\n    nsec: 4294967295", others="*id001")
"""The same with Humble's infinity, byte for byte as in the sample recordings."""
