"""Map files to arrays, and the digest that names a map."""
