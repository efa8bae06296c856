"""The two other readings of the paper's particle filter, as methods: rows that only its study has."""

from paper.cpf_gaussian import GaussianParticleFilter
from paper.cpf_literal import LiteralParticleFilter
from usbldr.filters.models.sigma_points import cubature, unscented
from usbldr.filters.replay.methods import METHODS, Method

_METHODS = (
    Method(
        "cpf-gaussian",
        "one Gaussian proposal, whitened draws",
        lambda motion, settings: GaussianParticleFilter(motion, cubature, settings.particles),
        smoother_transform=cubature,
        draws=True,
        multiple_hypotheses=True,
    ),
    *(
        Method(
            f"{name}-literal",
            f"{name} in the literal reading of the paper: loses its particles in dead reckoning",
            lambda motion, settings, rule=rule: LiteralParticleFilter(motion, rule, settings.particles),
            draws=True,
            estimates=frozenset(),
        )
        for name, rule in (("cpf", cubature), ("upf", unscented))
    ),
)
ROWS = {method.name: method for method in _METHODS}


def dask_setup(_worker: object) -> None:
    """Add the rows in a worker: dask worker --preload paper.readings."""
    METHODS.update(ROWS)
