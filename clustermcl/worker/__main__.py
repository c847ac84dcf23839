"""``python -I -m clustermcl.worker --settings FILE --count N``: N workers of this machine."""

from clustermcl.runtime.supervisor import use_one_thread_for_arithmetic

use_one_thread_for_arithmetic()  # before numpy is imported

from clustermcl.worker.process import main  # noqa: E402 - see above

main()
