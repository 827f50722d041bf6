"""The contact: its energy, the residual of equilibrium, its Hessian."""

from jaxstab.contact.contact import Contact, require_contact, require_same_contact

__all__ = ["Contact", "require_contact", "require_same_contact"]
