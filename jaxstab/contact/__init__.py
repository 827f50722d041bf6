"""The contact: its energy, the residual of equilibrium, its Hessian."""

from jaxstab.contact.contact import (
    Contact,
    require_contact,
    require_elastic,
    require_same_contact,
)
from jaxstab.contact.resolution import pinning_error

__all__ = ["Contact", "pinning_error", "require_contact", "require_elastic", "require_same_contact"]
