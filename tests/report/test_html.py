import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree

import pytest

from gridpush_drake.identification.result import HypothesisEvidence, IdentificationStatus
from gridpush_drake.multibody.ground_truth import sample_ground_truth
from gridpush_drake.pushes.push_log import PushLog
from gridpush_drake.report.page import make_report
from tests.helpers.made_identifications import make_block, make_identification
from tests.helpers.simulated_pushes import make_pushes

VOID = {"meta", "img", "br"}


class Checker(HTMLParser):
    """Checks that tags are closed in order, and collects what the page refers to."""

    def __init__(self):
        super().__init__()
        self.open, self.sources = [], []

    def handle_starttag(self, tag, attrs):
        self.sources += [value for name, value in attrs if name in ("src", "href")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def experiment():
    obj = make_block()
    truth = sample_ground_truth(obj, 1)
    log = make_pushes(obj, truth, 6, 1)
    return make_identification(obj), log[:4], log[4:], truth


@pytest.fixture(scope="module")
def page(experiment):
    """The report with the truth and pushes held out."""
    return make_report(*experiment)


@pytest.fixture
def short_page(experiment, undrawn):
    """The report of the pushes alone."""
    return make_report(*experiment[:2])


def figures_of(page):
    checker = Checker()
    checker.feed(page)
    assert not checker.open
    prefix = "data:image/svg+xml;base64,"
    assert all(source.startswith(prefix) for source in checker.sources)
    return [
        ElementTree.fromstring(base64.b64decode(source.removeprefix(prefix)))
        for source in checker.sources
    ]


def test_is_one_page_that_needs_nothing_else(experiment, page):
    result = experiment[0]
    assert len(figures_of(page)) == 7
    assert not re.search(r"https?://(?!www\.w3\.org)", page)
    for text in (
        "pushes it had never seen",
        "truth",
        "2 pushes held out",
        *result.identifiability.statements,
    ):
        assert text.replace("'", "&#39;") in page


def test_the_drawing_of_a_single_push_is_no_page_high(experiment):
    result, log, *_ = experiment
    page = make_report(result, log[:1])
    heights = [float(figure.get("height").removesuffix("pt")) for figure in figures_of(page)]
    assert max(heights) < 5 * 72


def test_draws_how_the_error_fell_push_by_push(experiment, page, undrawn):
    longer = make_report(*experiment, learning=[0.03, 0.012, 0.004])
    assert len(figures_of(longer)) == 8
    assert "Push by push" in longer
    assert "Push by push" not in page


def test_needs_neither_truth_nor_held_out_pushes(short_page):
    assert len(figures_of(short_page)) == 7
    assert "the pushes it learned from" in short_page
    assert "held out" not in short_page.lower().replace("pushes held out", "")


def test_says_that_the_prior_was_kept(experiment, undrawn):
    result, log, _, _ = experiment
    assert "no reason to leave" in make_report(
        replace(result, status=IdentificationStatus.PRIOR_KEPT), log
    )


def test_says_that_nothing_was_learned(experiment, undrawn):
    result, log, _, _ = experiment
    names = tuple(seen.name for seen in log)
    nothing = replace(
        result, status=IdentificationStatus.NO_DATA, history=(), push_names=(), unused_pushes=names
    )
    page = make_report(nothing, log)
    assert "Nothing was learned" in page
    assert len(figures_of(page)) == 4


def test_escapes_names(experiment, undrawn):
    result, log, _, _ = experiment
    nasty = replace(log[0], name="<script>alert(1)</script>")
    page = make_report(replace(result, unused_pushes=(nasty.name,)), PushLog((nasty, *log[1:])))
    assert "<script" not in page


def test_many_pushes_are_drawn_as_points(experiment, undrawn):
    result, log, held_out, _ = experiment
    many = tuple(replace(log[i % 4], name=f"push_{i}") for i in range(40))
    page = make_report(replace(result, unused_pushes=()), PushLog(many), held_out)
    assert "The first 8 of 42 pushes" in page
    figures_of(page)


def test_is_the_same_every_time(experiment, page):
    assert make_report(*experiment) == page


def test_names_the_hypotheses_of_the_loads_that_the_estimate_rests_on(experiment, short_page):
    result, log, _, _ = experiment
    weighed = (
        HypothesisEvidence("rigid bottom", -2.0, -1.0, 0.12),
        HypothesisEvidence("smooth field 1.5", 0.0, 0.0, 0.875),
        HypothesisEvidence("two parts 1", -9.0, -2.0, 0.005),
    )
    page = make_report(replace(result, hypotheses=weighed), log)
    assert "smooth field 1.5 (88 %), rigid bottom (12 %)" in page and "two parts 1" not in page
    assert "hypotheses of the loads" not in short_page
