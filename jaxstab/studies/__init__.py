"""Many contacts in one store; finished cases are never lost or run again."""

from jaxstab.studies import cases
from jaxstab.studies.study import StudyInterrupted, study

__all__ = ["StudyInterrupted", "cases", "study"]
