"""ROS 2 without a ROS installation: message types, wire formats, and nodes over Zenoh and DDS.

message_types  definitions and type hashes
cdr            messages as bytes
topic_keys     keys, liveliness tokens and attachments of rmw_zenoh
node           what a node can do, whatever the middleware; the URL of a topic
zenoh_node     a node over Zenoh
dds_node       a node over DDS
diagnostics    a report as diagnostics and covariances
ros_output     publishes both for the daemon
"""
