"""Import this beside Warp or Newton: no start-up banner and no line for every kernel module that is loaded."""

import warp as wp

wp.config.log_level = wp.LOG_WARNING
