"""The mathematics: arrays in, arrays out. Knows no Zenoh, file, log or clock."""
