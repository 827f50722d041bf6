"""Versions of packages, and optional packages, which extras of jaxstab install."""

from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec

# h5netcdf does not install h5py.
NETCDF = ("xarray", "h5netcdf", "h5py")
# Numbers depend on these packages.
_PACKAGES = ("jaxstab", "jax", "jaxlib", "equinox", "numpy")


def versions() -> dict[str, str]:
    """Return the versions of the packages on which numbers depend."""
    return {name: version(name) for name in _PACKAGES}


def are_installed(*packages: str) -> bool:
    """Whether all of the packages are installed."""
    return all(find_spec(name) for name in packages)


def require_packages(purpose: str, extra: str, *packages: str) -> None:
    """Import all of the packages, or raise `ImportError` with the extra that installs them."""
    try:
        for name in packages:
            import_module(name)
    except ImportError as error:
        sentence = f"{purpose} need {', '.join(packages)}: pip install 'jaxstab[{extra}]'."
        raise ImportError(sentence) from error
