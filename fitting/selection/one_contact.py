"""Whether runs that no law describes together are runs of one contact: each is fitted alone."""

import math
from collections.abc import Mapping, Sequence
from itertools import combinations

from fitting.estimation.derived import RUNS_OWN
from fitting.estimation.result import Parameter
from fitting.selection.contradictions import CONTRADICTED_BY
from processing.record.finding import Finding

RunLaws = Mapping[int | str, Mapping[str, Parameter]]  # the laws that describe a run alone, with their parameters


def find_other_contact(each: Sequence[RunLaws]) -> Finding | None:
    """Return the parameter in which two runs differ most, where one law describes each of them alone; else None.

    ``each`` are the laws of each run, best first.
    """
    law = next((law for law in each[0] if all(law in laws for laws in each)), None)
    if law is None:
        return None
    found = [
        (_distance(each[one][law][name], each[other][law][name]), name, one, other)
        for one, other in combinations(range(len(each)), 2)
        for name in each[one][law]
        if name in each[other][law] and name not in RUNS_OWN
    ]
    sigmas, name, one, other = max(found)
    if sigmas <= CONTRADICTED_BY:
        return None
    first, second = each[one][law][name], each[other][law][name]
    text = (
        f"these runs are not one contact: law {law} describes each of them alone, with {name} = {first.value:.4g} +- "
        f"{first.stderr:.2g} {first.unit} in run {one + 1} and {second.value:.4g} +- {second.stderr:.2g} {second.unit} "
        f"in run {other + 1}"
    )
    return Finding("not-one-contact", text, second.value, first.value, sigmas)


def _distance(one: Parameter, other: Parameter) -> float:
    spread = math.hypot(one.stderr, other.stderr)
    return abs(one.value - other.value) / spread if spread > 0 else 0.0
