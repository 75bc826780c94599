"""The console in browsers that keep nothing, as where cookies are blocked."""

from tests.browser.conftest import Open
from tests.browser.test_console_keys import Locked, locked, sign_in

__all__ = ["locked"]  # a fixture

BLOCKED = """for (const name of ["localStorage", "sessionStorage"])
    Object.defineProperty(window, name, { get() { throw new DOMException("Access is denied", "SecurityError"); } });"""


def test_the_console_works_where_the_browser_keeps_nothing(opened: Open, locked: Locked) -> None:
    """The page was empty below its head, and none of its buttons did anything."""
    service, keys = locked
    tab = opened(url=service.url, refusals=True)
    tab.page.context.add_init_script(BLOCKED)
    tab.page.reload()
    sign_in(tab, keys["admin"])
    tab.page.get_by_role("dialog").wait_for(state="detached")
    tab.page.get_by_role("button", name="Colours: auto").click()
    tab.page.get_by_role("link", name="Maps", exact=True).click()
    tab.page.get_by_role("heading", name="Maps", exact=True).wait_for()
    tab.awaits("main[aria-busy], #sign-in, .problem", 0)
