"""Topics through which a car is driven, named as in the predecessor system."""

__all__ = ["CONTROLLERS", "command_topic", "controller_topics"]

CONTROLLERS = (
    "left_rear_wheel_velocity_controller",
    "right_rear_wheel_velocity_controller",
    "left_front_wheel_velocity_controller",
    "right_front_wheel_velocity_controller",
    "left_steering_hinge_position_controller",
    "right_steering_hinge_position_controller",
)
"""Names of the controllers, in the order of the fields of `ControllerCommands`."""


def command_topic(vehicle: str) -> str:
    """Topic of a vehicle's commands (ackermann_msgs/AckermannDriveStamped)."""
    return f"/{vehicle}/ackermann_cmd_mux/output"


def controller_topics(vehicle: str) -> tuple[str, ...]:
    """Topics of its controllers' commands (std_msgs/Float64), in the order of `CONTROLLERS`."""
    return tuple(f"/{vehicle}/{controller}/command" for controller in CONTROLLERS)
