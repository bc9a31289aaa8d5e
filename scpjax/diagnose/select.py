"""Which left-out mechanisms do the recordings ask for? Every one is tried, and chosen on data held out from fitting."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

from scpjax.abreast import meanwhile
from scpjax.diagnose.choice import Choice, Progress
from scpjax.diagnose.evidence import Evidence, chance_against, is_better
from scpjax.diagnose.exchange import laws_of_two
from scpjax.diagnose.holdout import Split
from scpjax.diagnose.hypothesis import State
from scpjax.diagnose.leap import leap, one_promises_the_rest
from scpjax.diagnose.own import ROOM
from scpjax.diagnose.patience import Patience
from scpjax.diagnose.remainder import FAR, at_noise
from scpjax.diagnose.screen import ready_beside_names
from scpjax.diagnose.trials import in_order
from scpjax.diagnose.ways import WAYS, Branch, Search, Tried, named, one_more, try_round, with_own_room, with_own_values
from scpjax.diagnose.worth import worthwhile
from scpjax.fit.setup import Setup

_SURE = 2  # rounds that are gone however long they take: without a second name a first one is often given up
_NEAR = 9.0  # mean square, in units of the noise's, within which what is left may be due to long steps
_OTHERS = 2  # gone where the best one ends away from the noise


def choose(
    base: State,
    split: Split,
    rules: Evidence,
    catalogue: Setup,
    *,
    max_steps: int = 40,
    progress: Progress | None = None,
    enough: Callable[[State], bool] | None = None,
    mend: Callable[[Choice], Choice] | None = None,
    resolve: Callable[[State], bool] | None = None,
    patience: Patience | None = None,
) -> Choice:
    """Forward selection with pruning, from the base hypothesis; ``catalogue`` is the problem with every candidate.
    ``enough(first)`` says whether to end with the first name, ``resolve(leader)`` with what leads a round near the
    noise because it is there by shorter steps; out of ``patience`` neither a third round nor another way is begun, nor
    another round on such a way.

    Two that end away from the noise are asked for their laws together before a third is sought beside them.
    Where two mechanisms are close and neither reaches the noise, both ways are gone one round further, the second only
    if what it has named is not part of what explains all on the first. Where the way ends away from the noise and
    ``mend`` does not bring it there, others that had evidence in the first round are gone too. One mechanism that
    imitates two can be ahead of both: beside the first name two are tried at once in place of the second, before the
    last round where no single one promises the rest of the misfit there, else after ``mend``.
    """
    search = Search(base, split, rules, catalogue, max_steps, patience or Patience())
    mend = mend or (lambda choice: choice)

    def tell(text: str, round_: int) -> None:
        if progress:
            progress(f"round {round_}: trying {text}", 0.15 + 0.2 * (round_ - 1))

    branches, leapt = [Branch(base)], False
    both: Branch | None = None
    rounds: list[list[Tried]] = []
    leaders: list[Branch] = []
    rooms: list[Branch] = []  # that begin with a room which differs by recording
    for round_ in range(1, rules.most + 1):
        if len(leaders) >= _SURE and search.patience.over():
            break
        further, with_room = _gone_on(search, branches, rounds, round_, tell)
        rooms = rooms if rounds[1:] else with_room
        leader = _best(further, split, rules)
        if round_ < rules.most and not leader.ended:
            leader = replace(leader, state=laws_of_two(leader.state, split, rules, search.patience))
        leaders.append(leader)
        if leader.ended or at_noise(leader.state, split):
            break
        if round_ == 1 and enough is not None and enough(leader.state):
            return _choice(leader)
        if resolve is not None and at_noise(leader.state, split, _NEAR) and resolve(leader.state):
            return _choice(leader)
        far = not at_noise(leader.state, split, FAR)
        if far and round_ == _SURE < rules.most and not one_promises_the_rest(search, leader.state):
            both, leapt = _two_at_once(search, rounds, leaders, leader.state, tell), True
            if both and at_noise(both.state, split):
                return _choice(both)
        branches = _ways_on(leader, further)
    ahead = both is not None and is_better(both.state, leaders[-1].state, split, rules)
    choice = _choice(both if both and ahead else leaders[-1])
    if at_noise(choice.state, split, FAR):
        return choice
    choice = _away_from_noise(search, choice, rounds, leaders, rooms, mend, tell, leapt=leapt)
    strongest = next((c.added for c in rounds[0][0].accepted if c.added in choice.state.names), None)
    return choice if strongest is None else replace(choice, state=in_order(choice.state, strongest, split))


def _ways_on(leader: Branch, further: Sequence[Branch]) -> list[Branch]:
    """The ways to go on: the best one and others. The same names reached by another way are no way of their own, unless
    with values that all recordings share: what another mechanism does a name may make up for that differs by recording.
    """
    others = [b for b in further if not b.ended and {*b.state.names} != {*leader.state.names}]
    alike = [b for b in further if not b.ended and {*b.state.names} == {*leader.state.names}]
    shared = [b for b in alike if not b.state.setup.structure.own] if leader.state.setup.structure.own else []
    return [*[leader, *others][:WAYS], *shared[:1]]


def _away_from_noise(
    search: Search,
    choice: Choice,
    rounds: Sequence[Sequence[Tried]],
    leaders: Sequence[Branch],
    rooms: Sequence[Branch],
    mend: Callable[[Choice], Choice],
    tell: Callable[[str, int], None],
    *,
    leapt: bool,
) -> Choice:
    """What is named in the end where all rounds end away from the noise: the choice mended, with two names at once in
    place of the second unless that was tried (``leapt``), or found by another way.
    """
    split = search.split
    choice = mend(choice) if choice.state.names else choice
    if not (leapt or at_noise(choice.state, split, FAR)) and len(leaders) > _SURE:
        both = _two_at_once(search, rounds, leaders, choice.state, tell)
        choice = _choice(both) if both else choice
    if not at_noise(choice.state, split, FAR):
        other = _by_another_way(search, rounds, rooms, leaders, choice.state, tell)
        choice = choice if other is None else mend(_choice(other))
    return choice


def _gone_on(
    search: Search,
    ways: Sequence[Branch],
    rounds: list[list[Tried]],
    round_: int,
    tell: Callable[[str, int], None],
) -> tuple[list[Branch], list[Branch]]:
    """Some ways with one name more, or with what may differ by recording; and of these those that begin with a room.
    What was tried is added to ``rounds``.
    """
    split = search.split
    tell("every mechanism", round_)
    rounds.append([])
    further: list[Branch] = []
    for way in ways:
        if any(at_noise(b.state, split) and {*way.state.names} < {*b.state.names} for b in further):
            continue  # it is part of what explains all
        if further and search.patience.over():
            break
        rounds[-1].append(try_round(search, way, round_, tell))
        with meanwhile(partial(_for_more, search, rounds)):
            further += one_more(search, rounds[-1][-1])
    if any(at_noise(b.state, split) for b in further) or search.patience.over():
        return further, []
    tell("what may differ by recording", round_)
    with_room = [b for found in rounds[-1] for b in with_own_room(search, found)]
    with_values = [b for way in further if not way.ended and (b := with_own_values(search, way))]
    return [*further, *(b for b in (*with_room, *with_values) if at_noise(b.state, split, FAR))], with_room


def _two_at_once(
    search: Search,
    rounds: Sequence[Sequence[Tried]],
    leaders: Sequence[Branch],
    against: State,
    tell: Callable[[str, int], None],
) -> Branch | None:
    """The best way with two names at once in place of the second, on any way of its round, that is better than
    ``against``; None where none is.
    """
    leader = leaders[_SURE - 1].state
    best: Branch | None = None
    for found in rounds[_SURE - 1]:
        way = found.way.state
        led = leader if {*way.names} < {*leader.names} else way
        best = leap(search, found, led, best.state if best else against, lambda text: tell(text, _SURE)) or best
        if best and at_noise(best.state, search.split):
            break
    return best


def _for_more(search: Search, rounds: Sequence[Sequence[Tried]]) -> None:
    """Have the program that rounds after the first need compiled where there will be one, as it seems."""
    if len(rounds) > 1 or search.rules.most < 2:
        return
    ((first,),) = rounds
    if not (first.ends or any(at_noise(c.state, search.split) for c in first.accepted)):
        ready_beside_names(search.catalogue)


def _choice(leader: Branch) -> Choice:
    names = leader.state.names
    chance = {n: leader.chance(n) for n in names}
    equivalents = {n: leader.equivalents.get(n, ()) for n in names}
    return Choice(leader.state, leader.ranking, chance, equivalents, together=leader.together)


def _best(branches: Sequence[Branch], split: Split, rules: Evidence) -> Branch:
    """The best of some ways. What had less evidence when it was named, and led further, has that for it; a name that is
    also on the way it was ahead of, or that another order of the same names has, all that speaks for it there.
    """
    leader = branches[0]
    for b in branches[1:]:
        names = b.state.names
        if is_better(b.state, leader.state, split, rules):
            lead = chance_against(b.state, leader.state, split, rules)
            leader = _surer(b, {n: leader.chance(n) if n in leader.state.names else lead for n in names})
        elif {*names} == {*leader.state.names}:
            leader = _surer(leader, {n: b.chance(n) for n in names})
    return leader


def _surer(way: Branch, chance: Mapping[str, float]) -> Branch:
    """A way with names as likely as it is said elsewhere, where that is more."""
    return replace(way, own=way.own | {n: p for n, p in chance.items() if p > way.chance(n)})


def _by_another_way(
    search: Search,
    rounds: Sequence[Sequence[Tried]],
    rooms: Sequence[Branch],
    leaders: Sequence[Branch],
    best: State,
    tell: Callable[[str, int], None],
) -> Branch | None:
    """The best of ways that begin with another name of the first of the ``rounds``, or with one of ``rooms``, each gone
    on for as long as it leads what led at its length; None where none is better than ``best``, where the search has
    come to. One that the second round has gone on with does not lead what led then.
    A room that differs by recording can take many forms: with it the noise has to be reached.

    What speaks for the name with which such a way begins is all that the way has ahead of what led before.
    """
    split, rules = search.split, search.rules
    leader: Branch | None = None
    first = rounds[0][0]
    gone = [found.way.state.names for found in rounds[1]] if rounds[1:] else []
    others = [c for c in first.accepted if c.added not in leaders[0].state.names][:_OTHERS]
    others = [c for c in others if (c.added,) not in gone]
    ways = [(ROOM, lambda room=room: room) for room in rooms]
    ways += [(c.added, lambda c=c: named(search, first, c)) for c in others]
    for name, begin in ways:
        if search.patience.over():
            break
        way = begin()
        for round_ in range(2, rules.most + 1):
            if search.patience.over():
                break
            (way,) = one_more(search, try_round(search, way, round_, tell), ways=1)
            if way.ended or not is_better(way.state, leaders[min(round_, len(leaders)) - 1].state, split, rules):
                break
            if at_noise(way.state, split):
                break
        if way.state.setup.structure.own and not at_noise(way.state, split, FAR):
            continue
        if is_better(way.state, best, split, rules) and _earned(search, best, way.state):
            own = chance_against(way.state, best, split, rules)
            leader, best = replace(way, own={name: own}), way.state
        if at_noise(best, split):
            break
    return leader


def _earned(search: Search, before: State, after: State) -> bool:
    """Whether names beyond all those of another hypothesis are worth it, as they have to be when they are added."""
    if not set(before.names) < set(after.names):
        return True
    return worthwhile(before, after, search.base, search.split, search.rules)
