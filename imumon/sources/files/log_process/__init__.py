"""Log process: a program that reads bags and logs of autopilots with limits, for `log_file`.

__main__          limits, and the exchange with `log_file`
base              topics of a log
bag_reader        rosbag 1, rosbag 2, MCAP of ROS
mcap_reader       JSON in other MCAP files
message_fields    fields of serialised ROS messages
ulog_reader       PX4 ULog
dataflash_reader  ArduPilot DataFlash (.BIN)

The packages that read these files are not made for hostile ones: a kilobyte of metadata may expand to any size, a
chunk may decompress to any size, a database may contain a view without an end. The program therefore runs as a
process of its own, under limits that the kernel enforces. Whatever a file breaks is this process.

A connection of `multiprocessing` joins it and its parent. It sends the topics of the log as JSON and receives the
topic and the columns that are wanted. For each block it then sends the bytes read and the rows, numbers of 64 bits. An
error may take the place of each. Nothing is pickled: the parent runs nothing that a file can have made. It is a program
of its own and no `multiprocessing.Process`, which would import the main module again and leave a second process behind.
"""
