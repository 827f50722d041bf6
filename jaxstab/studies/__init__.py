"""Many contacts in one store, of which nothing done is ever lost or run again."""

from jaxstab.studies import cases
from jaxstab.studies.study import StudyInterrupted, study

__all__ = ["StudyInterrupted", "cases", "study"]
