"""``python -I -m worker --settings FILE --count N``: N worker processes of this machine."""

from process_runtime.supervisor import use_one_thread_for_arithmetic

use_one_thread_for_arithmetic()  # before numpy is imported

from worker.process import main  # noqa: E402 - see above

main()
