# SPDX-License-Identifier: Apache-2.0
"""Mission deviation: `eq:action-deviation` and `eq:plan-deviation`."""

from fractions import Fraction

from authguard_reference.reasons import FIELD_OF, FIELDS


def action_deviation(reasons: list[str], weights: dict[str, int] | None) -> Fraction:
    """Compute D_M(a, s, t) of `eq:action-deviation`.

    Args:
        reasons: The findings of one decision.
        weights: w_j by field; what is left out weighs 1.

    Returns:
        The weighted share of the protected fields that are violated.

    Raises:
        ValueError: If a weight is not positive.
    """
    given = weights if weights is not None else {}
    violated = [FIELD_OF.get(reason, "") for reason in reasons]
    above = 0
    below = 0
    for field in FIELDS:
        weight = given.get(field, 1)
        if weight <= 0:
            raise ValueError("the paper wants every weight above zero")
        d = 1 if field in violated else 0
        above += weight * d
        below += weight
    return Fraction(above, below)


def plan_deviation(
    plan: list[list[str]], weights: dict[str, int] | None
) -> tuple[Fraction, Fraction]:
    """Compute D_M(P) of `eq:plan-deviation` and the average beside it.

    Args:
        plan: The findings of each action, in the plan's order.
        weights: As for action_deviation.

    Returns:
        The maximum and the average.

    Raises:
        ValueError: If the plan has no action.
    """
    if plan == []:
        raise ValueError("a plan without actions has no deviation")
    each = [action_deviation(reasons, weights) for reasons in plan]
    return max(each), sum(each, Fraction(0)) / len(each)
