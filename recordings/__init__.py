"""Files of robots: recordings of any format, the maps in files and bags, and runs that we write."""
