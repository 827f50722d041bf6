"""The stages of a verdict."""

from jaxstab.stability.stages.verdict import VerdictStages

__all__ = ["VerdictStages"]
