"""The console behind the example configuration of nginx: its password, and its limit of requests.

Tabs are closed before the proxy stops: they go on asking it, and complain when it is gone.
"""

from contextlib import closing
from pathlib import Path

import httpx

from tests.browser.conftest import Open, Tab
from tests.stories.running import RunningService
from tests.stories.test_behind_nginx import PASSWORD, proxy


def signed_in(opened: Open, client: httpx.Client, screen: str) -> Tab:
    """A tab whose browser was told the proxy's password."""
    name, word = PASSWORD
    url = str(client.base_url).rstrip("/")
    return opened(screen, url=url, http_credentials={"username": name, "password": word})


def test_the_password_of_the_proxy_opens_every_screen(opened: Open, service: RunningService, tmp_path: Path) -> None:
    with (
        proxy(tmp_path / "nginx", service.url) as client,
        closing(signed_in(opened, client, "maps/town")) as tab,
    ):
        tab.page.get_by_label("View 1: mill lane").wait_for()
        tab.page.wait_for_selector(".grid img[src^=blob]")
        tab.show("service")
        tab.page.get_by_text("Ready", exact=True).wait_for()
        assert tab.page.get_by_role("dialog").count() == 0


def test_loading_the_page_again_and_again_is_not_refused(opened: Open, service: RunningService, tmp_path: Path) -> None:
    with (
        proxy(tmp_path / "nginx", service.url, rate=10) as client,
        closing(signed_in(opened, client, "maps")) as tab,
    ):
        for _ in range(3):
            tab.page.reload()
            tab.page.get_by_role("link", name="town", exact=True).wait_for()


def test_an_address_with_the_password_in_it_opens_the_console(
    opened: Open, service: RunningService, tmp_path: Path
) -> None:
    with proxy(tmp_path / "nginx", service.url) as client:
        url = str(client.base_url.copy_with(username=PASSWORD[0], password=PASSWORD[1])).rstrip("/")
        with closing(opened("maps", url=url)) as tab:
            tab.page.get_by_role("link", name="town", exact=True).wait_for()
            tab.complaints.clear()  # the address without the password is another host to this test
