"""What a laser scan says of a pose: the sensor model, likelihood fields, ray casting."""
