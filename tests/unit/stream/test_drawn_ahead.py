"""Parameters of many steps by one draw are those of each step, and none is drawn beyond the end."""

import torch

from sdm.stream.drawn_ahead import AT_ONCE, DrawnAhead


class Draws:
    """A draw that can be told from its number, and notes what it was asked."""

    def __init__(self) -> None:
        self.asked: list[torch.Tensor] = []

    def __call__(self, index: torch.Tensor) -> torch.Tensor:
        self.asked.append(index)
        return torch.stack([index.float(), -index.float()], 1)


def test_each_step_has_its_numbers_and_their_parameters():
    draws = Draws()
    # The second of three ranks, with batches of four.
    drawn = DrawnAhead(draws, 4, 4, 12, None)
    steps = range(36, 36 + 12 * 1000, 12)
    for at in (0, 1, 2, 5, 6, 900):
        several = steps[at : at + 3]
        numbers, theta = drawn.take(several)
        assert torch.equal(numbers, torch.tensor(several)[:, None] + 4 + torch.arange(4))
        assert torch.equal(theta[..., 0], numbers.float())
        assert torch.equal(theta[..., 1], -numbers.float())


def test_steps_that_follow_each_other_take_one_draw():
    draws = Draws()
    drawn = DrawnAhead(draws, 16, 0, 16, None)
    for step in range(0, AT_ONCE, 64):
        drawn.take(range(step, step + 64, 16))
    assert [len(index) for index in draws.asked] == [AT_ONCE]


def test_more_than_a_draw_at_once():
    numbers, _ = DrawnAhead(Draws(), AT_ONCE, 0, AT_ONCE, None).take([0, AT_ONCE])
    assert torch.equal(numbers.reshape(-1), torch.arange(2 * AT_ONCE))


def test_nothing_is_drawn_beyond_the_end():
    draws = Draws()
    drawn = DrawnAhead(draws, 2, 2, 4, 12)
    for step in (0, 4, 8):
        drawn.take([step])
    assert torch.cat(draws.asked).tolist() == [2, 3, 6, 7, 10, 11]


def test_numbers_drawn_in_inference_mode_may_be_written_into_later():
    drawn = DrawnAhead(Draws(), 2, 0, 2, None)
    with torch.inference_mode():
        drawn.take([0])
    numbers, _ = drawn.take([2])
    assert not numbers.is_inference()
    assert (numbers.add_(1) == torch.tensor([[3, 4]])).all()
