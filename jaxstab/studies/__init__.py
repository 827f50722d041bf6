"""Many contacts in one store; finished cases are never lost or run again."""

from jaxstab.studies.study import StudyInterrupted, study

__all__ = ["StudyInterrupted", "study"]
