"""What a laser scan says of a pose: sensor models, likelihood fields, ray casting."""
