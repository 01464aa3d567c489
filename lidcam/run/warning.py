"""A warning about the result of a run."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RunWarning:
    """Why part of a result may be missing or wrong, and what to do."""

    subject: str  # Name of the sensor, the topic or the step
    finding: str  # The finding
    remedy: str  # The remedy to try

    def __str__(self) -> str:
        return f"{self.subject}: {self.finding}; {self.remedy}"
