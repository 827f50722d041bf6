"""Packages that do not come with jaxstab, but with one of its extras."""

from importlib.util import find_spec

# The second comes without the third.
NETCDF = ("xarray", "h5netcdf", "h5py")


def are_installed(*packages: str) -> bool:
    """Return whether all of some packages are."""
    return all(find_spec(name) for name in packages)


def require_packages(purpose: str, extra: str, *packages: str) -> None:
    """Raise `ImportError` that names the extra, unless all of its packages are installed."""
    if not are_installed(*packages):
        raise ImportError(f"{purpose} need {', '.join(packages)}: pip install 'jaxstab[{extra}]'.")
