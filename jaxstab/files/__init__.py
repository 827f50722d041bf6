"""Results as labelled data sets, and on disk."""

from jaxstab.files.dataset import to_dataset
from jaxstab.files.netcdf import load, save

__all__ = ["load", "save", "to_dataset"]


def __dir__() -> list[str]:
    return __all__
