"""Run the page's server."""

from live_view.process import main

main()
