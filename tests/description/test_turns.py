"""Queries first, and after eight of them one of the enrolments that wait."""

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
