"""What a contact does: its patches, what it conducts, what leaks through it."""

from jaxstab.observables.patches import Patches, patches

__all__ = ["Patches", "patches"]
