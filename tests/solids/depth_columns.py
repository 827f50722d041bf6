"""Elastic half spaces by other means: a column of finite elements in depth, a direct integral."""

import numpy as np
from numpy.polynomial import legendre

VOIGT = np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2]])
DEGREE = 14


def tensor_of(stiffness, axes=((1, 0, 0), (0, 1, 0), (0, 0, 1))):
    """Return the elastic constants C_ijkl in the axes of a surface, from Voigt's matrix."""
    stiffness, axes = np.asarray(stiffness, float), np.asarray(axes, float)
    if stiffness.shape == (3,):
        c11, c12, c44 = stiffness
        stiffness = np.diag([c11 - c12] * 3 + [c44] * 3) + c12 * np.pad(np.ones((3, 3)), (0, 3))
    axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    own = stiffness[VOIGT[:, :, None, None], VOIGT]
    return np.einsum("ip,jq,kr,ls,pqrs->ijkl", axes, axes, axes, axes, own)


def isotropic(modulus, nu):
    """Return (c11, c12, c44) of an isotropic material."""
    shear = modulus / (2 * (1 + nu))
    first = 2 * shear * nu / (1 - 2 * nu)
    return first + 2 * shear, first, shear


def random_stiffness(random, spread=1.0):
    """Return random elastic constants, symmetric and positive definite."""
    factor = np.eye(6) + spread * random.normal(size=(6, 6)) / 3
    return factor @ np.diag(random.uniform(0.5, 2, 6)) @ factor.T


def random_axes(random):
    """Return three random directions at right angles."""
    return np.linalg.qr(random.normal(size=(3, 3)))[0]


def barnett_lothe_stiffness(tensor, vector, points=400):
    """Return K = |q| / (L^-1)_nn with L = -mean N_3 over the turns of the plane of q and n."""
    q = np.hypot(*vector)
    along, normal = np.array([*vector, 0]) / q, np.array([0, 0, 1.0])
    total = np.zeros((3, 3))
    for angle in np.pi * np.arange(points) / points:
        m = np.cos(angle) * along + np.sin(angle) * normal
        n = -np.sin(angle) * along + np.cos(angle) * normal
        mm, mn, nn = (np.einsum("ijkl,j,l->ik", tensor, a, b) for a, b in ((m, m), (m, n), (n, n)))
        total += mm - mn @ np.linalg.solve(nn, mn.T)
    return q / np.linalg.inv(total / points)[2, 2]


def _element(tensor, vector, depth):
    """Return the energy matrix of one element: displacements are Lobatto polynomials of depth."""
    nodes, weights = legendre.leggauss(DEGREE + 1)
    # Two ends, and integrals of Legendre polynomials, which vanish there.
    values = [(1 + nodes) / 2, (1 - nodes) / 2]
    slopes = [0 * nodes + 0.5, 0 * nodes - 0.5]
    for k in range(1, DEGREE):
        one = np.zeros(k + 1)
        one[k] = 1
        slopes.append(legendre.legval(nodes, one))
        values.append(legendre.legval(nodes, legendre.legint(one, lbnd=-1)))
    values, slopes = np.array(values), np.array(slopes) * 2 / depth
    direction = np.array([*vector, 0])
    # u_k,l of the shape function a with displacement along k.
    gradient = 1j * np.einsum("ap,l->apl", values, direction) + np.einsum(
        "ap,l->apl", slopes, [0, 0, 1.0]
    )
    energy = np.einsum(
        "p,apj,ijkl,bpl->aibk", weights * depth / 2, gradient.conj(), tensor, gradient
    )
    size = 3 * len(values)
    return energy.reshape(size, size)


def column_stiffness(layers, base, vector):
    """Return K at a wave vector, of layers (tensor, thickness, slips) on a base.

    The base is a tensor, cut where all waves have decayed, or None if it is rigid.
    """
    q = np.hypot(*vector)
    elements = []
    for tensor, thickness, slips in layers:
        number = int(np.ceil(q * thickness / 3)) or 1
        elements += [(tensor, thickness / number, False)] * (number - 1)
        elements.append((tensor, thickness / number, slips))
    if base is not None:
        elements += [(base, depth / q, False) for depth in np.geomspace(0.3, 60, 24)]
    size = 3 * (DEGREE + 1)
    total = np.zeros((size * len(elements), size * len(elements)), complex)
    for i, (tensor, depth, _) in enumerate(elements):
        part = slice(i * size, (i + 1) * size)
        total[part, part] = _element(tensor, vector, depth)
    # The top of each element is the bottom of the last; the lowest is held.
    basis = np.eye(total.shape[0])
    dropped = []
    for i, (_, _, slips) in enumerate(elements):
        bottom = i * size + 3 + np.arange(3)[2 if slips else 0 :]
        if i + 1 < len(elements):
            basis[bottom] += basis[(i + 1) * size + np.arange(3)[2 if slips else 0 :]]
        dropped += list(bottom)
    basis = np.delete(basis, dropped, axis=1)
    load = basis[2]
    return 1 / (load @ np.linalg.solve(basis.T @ total @ basis, load)).real
