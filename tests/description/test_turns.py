"""Queries first, and after eight of them one of the enrolments that wait; the newest query where callers give up."""

from dataclasses import dataclass

from worker.description.turns import CLOSE, ENROLMENT, IN_A_ROW, QUERY, Turns, Waiting


def test_a_batch_holds_queries_or_enrolments_and_never_too_many_in_a_row() -> None:
    turns: Turns[Waiting] = Turns()
    for number in range(3):
        turns.put(Waiting(ENROLMENT, number))
    for number in range(3, IN_A_ROW + 5):
        turns.put(Waiting(QUERY, number))
    turns.put(Waiting(CLOSE, 99))
    order, batches = [], []
    while (first := turns.get()) is not None and first.urgency != CLOSE:
        batch = [first]
        while (following := turns.get_alike(first)) is not None:
            batch.append(following)
        batches.append(len(batch))
        order += [one.number for one in batch]
    assert batches == [IN_A_ROW, 1, 2, 2]
    assert order == [*range(3, IN_A_ROW + 3), 0, IN_A_ROW + 3, IN_A_ROW + 4, 1, 2]
    assert turns.get(0.01) is None


@dataclass(eq=False)
class Call(Waiting):
    gone: bool = False

    @property
    def given_up(self) -> bool:
        return self.gone


def order(turns: Turns[Call]) -> list[int]:
    """Numbers of the queries that are served, in turn."""
    served = []
    while (request := turns.get(0)) is not None:
        if not request.given_up:
            served.append(request.number)
    return served


def test_queries_are_served_in_their_order_while_nobody_gives_up() -> None:
    turns: Turns[Call] = Turns()
    for number in (2, 0, 1):
        turns.put(Call(QUERY, number))
    assert order(turns) == [0, 1, 2]


def test_where_a_caller_gave_up_the_newest_query_has_the_next_turn() -> None:
    turns: Turns[Call] = Turns()
    for number in range(6):
        turns.put(Call(QUERY, number, gone=number in (0, 1, 3)))
    assert order(turns) == [5, 4, 2]


def test_an_enrolment_is_never_passed_over_for_a_newer_one() -> None:
    turns: Turns[Call] = Turns()
    for number in range(4):
        turns.put(Call(ENROLMENT, number, gone=number == 0))
    assert order(turns) == [1, 2, 3]


def test_who_is_woken_finds_nothing_or_what_came_meanwhile() -> None:
    turns: Turns[Waiting] = Turns()
    turns.wake()
    turns.wake()
    assert turns.get() is None
    turns.put(Waiting(QUERY, 1))

    assert turns.get() == Waiting(QUERY, 1)
    assert turns.get() is None
    assert turns.get_alike(Waiting(QUERY, 2)) is None
    assert turns.get(0) is None
