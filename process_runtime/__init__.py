"""What every process needs: settings, log, shutdown, children. No Zenoh in it."""
