"""How one motion fits a query of words, slot by slot: what all motions at once must say."""

from dousa.retrieval.words.matching import ALSO_DOES, DOES, NAME, OPPOSITE, Fit, is_whole


def fit(matcher, category, name, relations):
    """The match of the words of a category, of a name, and of relations with the share of the motion of each."""
    slots = matcher.query.slots
    total = sum(slot.weight for slot in slots)

    def add_up(values):
        return sum(slot.weight * value for slot, value in zip(slots, values, strict=True)) / total

    if not total:
        return Fit(0.0, (), False, False)
    by_category, against = matcher.find(category)
    by_name, name_against = matcher.find(name)
    scale = OPPOSITE if against or name_against else 1.0
    base = [scale * max(a, NAME * b) for a, b in zip(by_category, by_name, strict=True)]
    trust = ALSO_DOES if any(map(matcher.is_action, category.words)) else DOES
    gains = [
        tuple(trust * (0.8 + 0.2 * min(1.0, 2.0 * share)) * value for value in matcher.find_relation(unit))
        for unit, share in relations
    ]
    used = []
    for _ in range(2):
        better = [add_up(map(max, zip(base, values, strict=True))) for values in gains]
        if not better or max(better) <= add_up(base) + 1e-9:
            break
        used.append(better.index(max(better)))
        base = list(map(max, zip(base, gains[used[-1]], strict=True)))
        gains = [values if is_whole(values, slots) else (0.0,) * len(values) for values in gains]
    return Fit(add_up(base), tuple(used), any(v > 0.4 for v in by_category), any(v > 0.4 for v in by_name))
