"""Markdown tables: what is in a cell stays in it."""

import pytest

from flowbothd_common.markdown import markdown_table


def test_a_table_has_a_head_a_rule_and_its_rows():
    assert markdown_table(("a", "b"), [(1, "x"), ("", 2.5)]) == (
        "| a | b |\n|---|---|\n| 1 | x |\n|  | 2.5 |"
    )


def test_bars_and_line_breaks_stay_in_their_cell():
    """A failure that quoted a command with a bar moved all later columns by one."""
    last = markdown_table(["why"], [["a | b\nc"]]).splitlines()[-1]
    assert last == "| a \\| b c |"


def test_a_row_of_another_width_is_refused():
    with pytest.raises(ValueError, match="1 cells under 2"):
        markdown_table(("a", "b"), [(1,)])
