"""Run the page's server."""

from clustermcl.view.process import main

main()
