"""Log process: a program that reads bags and logs of autopilots with limits, for `log_file`.

__main__          limits, and the exchange with `log_file`
base              topics of a log
bag_reader        rosbag 1, rosbag 2, MCAP
message_fields    fields of serialised ROS messages
ulog_reader       PX4 ULog
dataflash_reader  ArduPilot DataFlash (.BIN)

The packages that read these files are not made for hostile ones: a kilobyte of metadata may expand to any size, a
chunk may decompress to any size, a database may contain a view without an end. The program therefore runs as a
process of its own, under limits that the kernel enforces. Whatever a file breaks is this process.

Its standard output is one line of JSON with the topics of the log. Its standard input is one line of JSON, the topic
and the columns, or null. It then sends, for each block, a line with the number of rows and of bytes read, and the
rows: numbers of 64 bits, one for each column. A line with an error may take the place of each.
"""
