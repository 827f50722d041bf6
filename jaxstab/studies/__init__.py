"""Many contacts in one folder; finished cases are never lost or run again."""

from jaxstab.studies.driver import StudyInterrupted
from jaxstab.studies.study import study

__all__ = ["StudyInterrupted", "study"]
