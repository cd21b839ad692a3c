for i in 1 2 3; do bash -c "time /work/main/.venv/bin/python -c 'import numpy, scipy.linalg, pinocchio'" 2>&1 | tr '\n' ' '; done; echo
