"""Which workers are there, who has which job, and how orders reach them."""
