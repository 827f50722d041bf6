"""Contacts of viscoelastic solids in time."""
