"""What every process needs: Zenoh session, inbox, settings, log, shutdown."""
