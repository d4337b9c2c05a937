"""Slip friction whose strength changes with the sliding so far: it beds in, or it wears."""

from ufl import exp

from wovenfab.forms.effect import Effect, InternalVariable, Needs, Parameter
from wovenfab.forms.friction import smooth_bound, smoothed_coulomb
from wovenfab.forms.slip_friction import slip


def strength(values):
    """Return the strength, which approaches its end over a length of sliding."""
    start, end = values["strength"], values["end"]
    return end + (start - end) * exp(-values["slid"] / values["length"])


def dissipation(rate, values):
    """Return the Rayleigh potential (W/m^2) of a slip rate (m/s)."""
    return sum(smoothed_coulomb(rate[i], strength(values), values["slope"]) for i in range(2))


def slid(now, before, values, step):
    """Return the sliding so far (m) at the end of a step."""
    change = slip(now) - slip(before)
    return values["slid"] + abs(change[0]) + abs(change[1])


EFFECT = Effect(
    name="wear",
    summary="Slip friction whose strength changes with the sliding so far",
    parameters=(
        Parameter("strength", "N/m^2", "largest friction stress at first"),
        Parameter("end", "N/m^2", "largest friction stress after much sliding"),
        Parameter("length", "m", "sliding over which it changes", zero_allowed=False),
        Parameter("slope", "s/m", "one over the slip rate of saturation", zero_allowed=False),
    ),
    memory=(InternalVariable("slid", "m", "sliding so far", slid),),
    needs=Needs(placements=2, rate=True),
    dissipation=dissipation,
    measure=slip,
    bound=smooth_bound(strength),
    resists=frozenset({"slipping"}),
)
