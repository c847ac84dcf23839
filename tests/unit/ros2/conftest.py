"""Messages of these tests are of the library `rosbags`."""

import tests.ros_messages  # noqa: F401 - gives it to the product
