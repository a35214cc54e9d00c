from tests.manual import words, words_by_page

LIMIT = 20_000


def test_the_manual_can_be_read_in_an_afternoon():
    pages = words_by_page()
    assert len(pages) > 35
    assert sum(pages.values()) <= LIMIT, pages


def test_code_link_targets_numbers_and_generated_text_are_no_words():
    text = "# One *two*\n\n| 3 | three |\n|---|---|\n```sh\nmake docs\n```\n[four](docs/x.md) 5 %\n"
    assert words(text + "<!-- generated: crowd -->\n\nno words\n\n<!-- end -->\nfive\n") == 5
