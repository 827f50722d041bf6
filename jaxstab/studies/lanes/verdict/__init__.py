"""The stages of a verdict."""

from jaxstab.studies.lanes.verdict.verdict import VerdictStages

__all__ = ["VerdictStages"]
