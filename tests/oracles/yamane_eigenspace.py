"""Section 3.1 and equations 8-14 of Yamane and Shakunaga, word for word in plain Python, without any speed.

Written from the paper, not from the fast code. Postures are lists of 27 numbers that face the same way already.
Eq. 10 is printed with Y#, the residual, where only Y*, the projection, makes sense; eq. 11 says so. Eigenvectors
come from Jacobi's rotations, so that nothing is shared with the fast code.
"""

import math


def mean(postures):
    return [sum(x[k] for x in postures) / len(postures) for k in range(len(postures[0]))]


def covariance(postures):
    middle = mean(postures)
    size = len(middle)
    sigma = [[0.0] * size for _ in range(size)]
    for x in postures:
        for r in range(size):
            for c in range(size):
                sigma[r][c] += (x[r] - middle[r]) * (x[c] - middle[c]) / len(postures)
    return sigma


def _rotate(a, v, p, q):
    """One of Jacobi's rotations: the entry p, q becomes 0."""
    if abs(a[p][q]) < 1e-300:
        return
    theta = (a[q][q] - a[p][p]) / (2 * a[p][q])
    t = math.copysign(1.0, theta) / (abs(theta) + math.sqrt(theta * theta + 1.0))
    c = 1.0 / math.sqrt(t * t + 1.0)
    s = t * c
    for k in range(len(a)):
        a[k][p], a[k][q] = c * a[k][p] - s * a[k][q], s * a[k][p] + c * a[k][q]
    for k in range(len(a)):
        a[p][k], a[q][k] = c * a[p][k] - s * a[q][k], s * a[p][k] + c * a[q][k]
    for k in range(len(a)):
        v[k][p], v[k][q] = c * v[k][p] - s * v[k][q], s * v[k][p] + c * v[k][q]


def eigen(sigma):
    """Eigenvalues, largest first, and their eigenvectors."""
    size = len(sigma)
    a = [row[:] for row in sigma]
    v = [[float(r == c) for c in range(size)] for r in range(size)]
    for _ in range(30):
        for p in range(size):
            for q in range(p + 1, size):
                _rotate(a, v, p, q)
        if sum(a[p][q] ** 2 for p in range(size) for q in range(size) if p != q) < 1e-28:
            break
    order = sorted(range(size), key=lambda k: -a[k][k])
    return [a[k][k] for k in order], [[v[r][k] for r in range(size)] for k in order]


def choose_dimensions(values, contribution):
    """The smallest m whose cumulative contribution reaches the wanted share."""
    for m in range(1, len(values) + 1):
        if sum(values[:m]) / sum(values) >= contribution:
            return m
    return len(values)


def project(x, middle, phi):
    """Eq. 8; phi is a list of eigenvectors."""
    return [sum(e[k] * (x[k] - middle[k]) for k in range(len(x))) for e in phi]


def residual(x, middle, phi):
    """Eq. 9."""
    star = project(x, middle, phi)
    return [x[k] - middle[k] - sum(phi[d][k] * star[d] for d in range(len(phi))) for k in range(len(x))]


def norm(x):
    return math.sqrt(sum(value * value for value in x))


def distance_from_space(y, middle, phi):
    """Eq. 10, with Y*."""
    star = project(y, middle, phi)
    return norm([y[k] - middle[k] - sum(phi[d][k] * star[d] for d in range(len(phi))) for k in range(len(y))])


def distance_from_space_by_residual(y, middle, phi):
    """Eq. 11."""
    return norm(residual(y, middle, phi))


def distance_within(x, y, middle, phi):
    """Eq. 12."""
    one, other = project(x, middle, phi), project(y, middle, phi)
    return norm([a - b for a, b in zip(one, other, strict=True)])


def distance_within_by_difference(x, y, phi):
    """Eq. 14."""
    return norm([sum(e[k] * (x[k] - y[k]) for k in range(len(x))) for e in phi])


def distance_to_path(y, reference):
    return min(norm([a - b for a, b in zip(x, y, strict=True)]) for x in reference)
