"""What tests of the Library page ask of it."""

CELLS = "return [...document.querySelectorAll('.cell')].filter((cell) => cell.cell.id && cell.offsetParent)"
COUNT = "return document.querySelector('#count').textContent"


def click(page, selector):
    page.wait("return document.querySelector(arguments[0])", selector)
    page.run("document.querySelector(arguments[0]).click()", selector)
    page.settle()


def wait_count(page, number):
    page.wait(f"{COUNT}.startsWith(arguments[0])", str(number))
    page.settle()
