"""Many contacts in one folder; finished cases are never lost or run again."""

from jaxstab.studies.study import StudyInterrupted, study

__all__ = ["StudyInterrupted", "study"]
