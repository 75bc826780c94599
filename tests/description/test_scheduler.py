"""Questions come first, one failure is one picture's, and stopping serves what was handed in."""

import threading
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pytest

from schemas.description import SEMANTIC, Floats, PixelField
from schemas.errors import Busy, Unavailable
from schemas.image import Picture
from schemas.records import Meaning
from worker.description.scheduler import Desk


class GatedEncoder:
    """Encodes one picture whenever the test lets it, and remembers the order."""

    name = "gated"
    digest = "0" * 64
    layers: Mapping[str, int] = {SEMANTIC: 1}

    def __init__(self) -> None:
        self.seen: list[int] = []
        self.gate = threading.Semaphore(0)
        self.entered = threading.Semaphore(0)

    def encode(self, pictures: Sequence[Picture]) -> Iterator[PixelField]:
        for picture in pictures:
            self.entered.release()
            self.gate.acquire()
            number = int(picture.pixels[0, 0, 0])
            if number == 99:
                raise RuntimeError("this picture kills the network")
            self.seen.append(number)
            yield PixelField({SEMANTIC: np.ones((1, 1, 1), np.float32)}, picture.extent)

    def fine(self, picture: Picture) -> PixelField:
        return PixelField({SEMANTIC: np.ones((2, 2, 1), np.float32)}, picture.extent)

    def text_vectors(self, words: Sequence[str]) -> Floats:
        raise AssertionError("not asked here")

    def meanings(self, words: Sequence[str]) -> list[Meaning]:
        raise AssertionError("not asked here")


def picture(number: int) -> Picture:
    return Picture.of(np.full((32, 32, 3), number, np.uint8))


def number_of(shown: Picture, _: PixelField) -> int:
    return int(shown.pixels[0, 0, 0])


def test_a_question_overtakes_every_enrolment_that_is_not_yet_under_way() -> None:
    encoder = GatedEncoder()
    desk = Desk(encoder, batch=1, questions=5)
    desk.start()
    enrolments = [desk.hand_in(picture(n), number_of, urgent=False) for n in (1, 2, 3)]
    encoder.entered.acquire()  # the first enrolment is being encoded
    question = desk.hand_in(picture(7), number_of, urgent=True)
    encoder.gate.release(4)

    assert question.result(5).value == 7
    assert [future.result(5).value for future in enrolments] == [1, 2, 3]
    assert encoder.seen == [1, 7, 2, 3]
    desk.stop()


def test_a_question_is_answered_while_an_enrolment_is_still_being_described() -> None:
    encoder = GatedEncoder()
    encoder.gate.release(9)
    desk = Desk(encoder, batch=1, questions=5)
    desk.start()
    asked = threading.Event()

    def slow(shown: Picture, field: PixelField) -> int:
        assert asked.wait(5)
        return number_of(shown, field)

    enrolments = [desk.hand_in(picture(n), slow, urgent=False) for n in (1, 2)]
    assert desk.hand_in(picture(7), number_of, urgent=True).result(5).value == 7
    asked.set()
    assert [future.result(5).value for future in enrolments] == [1, 2]
    desk.stop()


def test_what_needs_no_field_is_made_while_the_network_is_busy() -> None:
    encoder = GatedEncoder()
    desk = Desk(encoder, batch=1, questions=5)
    desk.start()
    made = threading.Event()

    def look(shown: Picture) -> str:
        made.set()
        return f"picture {shown.pixels[0, 0, 0]}"

    question = desk.hand_in(picture(7), lambda p, f, looked: (number_of(p, f), looked), urgent=True, beside=look)
    assert made.wait(5)  # and the encoder is still held back
    encoder.gate.release()
    assert question.result(5).value == (7, "picture 7")
    desk.stop()


def test_a_question_waits_for_nothing_that_is_made_beside_an_enrolment() -> None:
    encoder = GatedEncoder()
    encoder.gate.release(9)
    desk = Desk(encoder, batch=1, questions=5)
    desk.start()
    begun, answered = threading.Event(), threading.Event()

    def slow(_: Picture) -> bool:
        begun.set()
        return answered.wait(5)

    enrolment = desk.hand_in(picture(1), lambda p, f, waited: waited, urgent=False, beside=slow)
    assert begun.wait(5)
    question = desk.hand_in(picture(7), lambda p, f, looked: looked, urgent=True, beside=lambda _: "keypoints")
    assert question.result(3).value == "keypoints"
    answered.set()
    assert enrolment.result(5).value
    desk.stop()


def test_a_failure_beside_the_network_belongs_to_the_one_who_asked() -> None:
    encoder = GatedEncoder()
    encoder.gate.release(9)
    desk = Desk(encoder, batch=1, questions=5)
    desk.start()

    def fail(_: Picture) -> int:
        raise ValueError("no keypoints today")

    with pytest.raises(ValueError, match="no keypoints"):
        desk.hand_in(picture(1), lambda p, f, looked: looked, urgent=True, beside=fail).result(5)
    assert desk.hand_in(picture(2), number_of, urgent=True).result(5).value == 2
    desk.stop()


def test_one_failing_picture_does_not_take_its_batch_down() -> None:
    encoder = GatedEncoder()
    desk = Desk(encoder, batch=4, questions=5)
    futures = [desk.hand_in(picture(n), number_of, urgent=False) for n in (1, 99, 3)]
    encoder.gate.release(9)
    desk.start()

    assert futures[0].result(5).value == 1
    with pytest.raises(RuntimeError, match="kills"):
        futures[1].result(5)
    assert futures[2].result(5).value == 3
    desk.stop()


def test_more_questions_than_are_let_in_are_refused_with_a_time_to_come_back() -> None:
    desk = Desk(GatedEncoder(), batch=1, questions=2)
    for number in (1, 2):
        desk.hand_in(picture(number), number_of, urgent=True)

    with pytest.raises(Busy, match="2 questions are waiting") as refusal:
        desk.hand_in(picture(3), number_of, urgent=True)

    assert refusal.value.retry_after_s >= 1
    desk.hand_in(picture(4), number_of, urgent=False)  # enrolments have a queue of their own


def test_stopping_serves_what_was_handed_in_and_refuses_what_comes_after() -> None:
    encoder = GatedEncoder()
    encoder.gate.release(9)
    desk = Desk(encoder, batch=1, questions=5)
    futures = [desk.hand_in(picture(n), number_of, urgent=False) for n in (1, 2)]
    desk.start()
    desk.stop()

    assert [future.result(0).value for future in futures] == [1, 2]
    with pytest.raises(Unavailable):
        desk.hand_in(picture(3), number_of, urgent=True)


def test_an_error_of_the_finish_belongs_to_the_one_who_asked() -> None:
    encoder = GatedEncoder()
    encoder.gate.release(9)
    desk = Desk(encoder, batch=1, questions=5)
    desk.start()

    def refuse(_: Picture, __: PixelField) -> int:
        raise ValueError("nothing static here")

    with pytest.raises(ValueError, match="nothing static"):
        desk.hand_in(picture(1), refuse, urgent=True).result(5)
    assert desk.hand_in(picture(2), number_of, urgent=True).result(5).value == 2
    desk.stop()


def test_pictures_to_be_drawn_get_the_fine_field_among_others_that_do_not() -> None:
    encoder = GatedEncoder()
    encoder.gate.release(9)
    desk = Desk(encoder, batch=4, questions=5)
    wanted = [(1, False), (2, True), (3, False), (4, False)]

    def number_and_rows(shown: Picture, field: PixelField) -> tuple[int, int]:
        return number_of(shown, field), field.shape[0]

    futures = [desk.hand_in(picture(n), number_and_rows, urgent=True, fine=fine) for n, fine in wanted]
    desk.start()

    assert [future.result(5).value for future in futures] == [(1, 1), (2, 2), (3, 1), (4, 1)]
    desk.stop()
