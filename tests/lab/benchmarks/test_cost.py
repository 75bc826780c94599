"""The bill of a fleet, against numbers worked by hand."""

import pytest

from lab.benchmarks.cost import Load, Prices, bill, main

PRICES = Prices(memory=2.0, disk=0.1, objects=0.02, core=0.05)


def test_ten_million_views() -> None:
    found = bill(Load(views=10_000_000, queries=10, enrolled=0.0), PRICES)
    # 9.6 kB, twice; 69 kB, twice; 200 kB
    assert (found.memory, found.database, found.images) == (192.0, 1380.0, 2000.0)
    assert found.cores == 4  # 10 queries of 86 ms take less than two cores a copy
    assert found.month == {"memory": 384.0, "database": 138.0, "images": 40.0, "cores": 4 * 730 * 0.05}
    assert found.filling == pytest.approx(10_000_000 * 0.077 / 3600 * 0.05)


def test_many_queries_and_what_is_enrolled_anew_need_cores() -> None:
    found = bill(Load(views=1_000_000, queries=1000, enrolled=1.0, copies=3), PRICES)
    assert found.memory == pytest.approx(28.8)
    assert found.cores == pytest.approx(2 * 1000 * 0.086 + 1_000_000 * 0.077 / 3600 / 730)


def test_a_table_with_a_column_for_each_size(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--views", "1000", "2000000", "--queries", "1", "5", "--memory", "1", "--image-kb", "100"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["views", "1,000", "2,000,000"]
    assert lines[4].split() == ["images,", "GB", "0.1", "200.0"]
    assert lines[-2].startswith("all of it, a month")
    with pytest.raises(SystemExit):
        main(["--views", "1000", "--queries", "1", "5"])
