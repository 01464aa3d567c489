"""A warning about the result of a run."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class RunWarning:
    """Why part of a result may be missing or wrong, and what to do.

    Attributes:
        subject: Name of the sensor, the topic or the step.
        finding: The finding.
        remedy: The remedy to try.
    """

    subject: str
    finding: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.subject}: {self.finding}; {self.remedy}"
