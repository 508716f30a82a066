"""ROS 2 without a ROS installation: message types, wire formats, and nodes over Zenoh and DDS.

ros_messages  messages as bytes, names and hashes of their types
topic_keys    keys, liveliness tokens and attachments of rmw_zenoh
node          what a node can do, whatever the middleware
zenoh_node    a node over Zenoh
dds_node      a node over DDS
topic_url     the URL of a topic, and the node that it names
diagnostics   a report as diagnostics and covariances
ros_output    publishes both for the daemon
"""
