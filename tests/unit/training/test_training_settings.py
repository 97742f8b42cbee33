"""Settings come back from JSON as they were; a newer program's and damaged ones are refused."""

from __future__ import annotations

import json
import math

import pytest

from sdm.deepsdf import Settings as DeepSDFSettings
from sdm.deepsdf import local, published
from sdm.errors import FormatError, SDMError
from sdm.segmentation import Settings as SegmentationSettings
from sdm.surrogate import Settings as SurrogateSettings
from sdm.training.training_settings import check_choice, check_number

ALL = [
    published(),
    local(),
    SegmentationSettings(patch=(32, 16, 16), dropout=0.25),
    SurrogateSettings(steps=7, budget_s=2.5),
]


@pytest.mark.parametrize("settings", ALL, ids=lambda s: type(s).__module__)
def test_they_come_back_from_json(settings):
    again = type(settings).of_record(json.loads(json.dumps(settings.record())))
    assert again == settings
    assert hash(again) == hash(settings)


@pytest.mark.parametrize("kind", [DeepSDFSettings, SegmentationSettings, SurrogateSettings])
def test_those_of_a_newer_program_are_refused(kind):
    record = kind().record()
    sentence = r"m\.pt has settings that this program does not know \(novel\): use the sdm that wrote it"
    with pytest.raises(FormatError, match=sentence):
        kind.of_record({**record, "novel": 1}, "m.pt")


@pytest.mark.parametrize("kind", [DeepSDFSettings, SegmentationSettings, SurrogateSettings])
def test_those_that_were_no_choice_then_have_their_default(kind):
    record = kind().record()
    record.pop("seed")
    assert kind.of_record(record) == kind()


@pytest.mark.parametrize("kind", [DeepSDFSettings, SegmentationSettings, SurrogateSettings])
def test_damaged_ones_are_one_sentence(kind):
    record = kind().record()
    for name in record:
        for wrong in ({"a": 1}, object()):
            with pytest.raises(FormatError, match=r"m\.pt is damaged, or of another sdm"):
                kind.of_record({**record, name: wrong}, "m.pt")
    for wrong in ({**record, "seed": True}, {**record, "seed": 1.5}):
        with pytest.raises(FormatError, match=r"m\.pt is damaged"):
            kind.of_record(wrong, "m.pt")
    with pytest.raises(FormatError, match="its settings are not a table"):
        kind.of_record([1], "m.pt")


def test_those_that_cannot_be_trained_are_damaged_too():
    with pytest.raises(FormatError, match=r"m\.pt is damaged, or of another sdm: width is -1; it must be 1 or more"):
        DeepSDFSettings.of_record({**published().record(), "width": -1}, "m.pt")


def test_how_long_it_takes_may_change_half_way():
    one, other = SurrogateSettings(steps=7), SurrogateSettings(steps=9, budget_s=1.0)
    assert one.identity() == other.identity()
    assert one.identity() != SurrogateSettings(steps=7, rate=0.5).identity()
    assert SegmentationSettings(steps=7).identity() != SegmentationSettings(steps=8).identity()


def test_numbers_out_of_their_range():
    check_number("a", None, above=0)
    check_number("a", 1, least=1, most=1)
    for value, limits, words in (
        (0, {"above": 0}, "it must be more than 0$"),
        (0, {"least": 1}, "it must be 1 or more$"),
        (1.0, {"least": 0, "below": 1}, "it must be 0 or more and less than 1$"),
        (2, {"least": 0, "most": 1}, "it must be 0 or more and at most 1$"),
        (math.nan, {"least": 0}, "it must be 0 or more$"),
        (math.inf, {}, "it must be finite$"),
    ):
        with pytest.raises(SDMError, match=words):
            check_number("a_b", value, **limits)
    with pytest.raises(SDMError, match=r"^a b is 0"):
        check_number("a_b", 0, above=0)


def test_choices_that_there_are_not():
    check_choice("letter", "a", "ab")
    with pytest.raises(SDMError, match="there is no letter called 'c'; choose one of a, b"):
        check_choice("letter", "c", "ab")
