"""A page in the browser that draws the clusters as they are: one process, one page, one socket."""
