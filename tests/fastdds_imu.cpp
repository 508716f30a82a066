// A publisher or subscriber of sensor_msgs/msg/Imu with Fast DDS, the middleware of most ROS 2 systems.
//
//     fastdds_imu publish DOMAIN RATE COUNT
//     fastdds_imu listen DOMAIN COUNT
//
// Topic and type are those of ROS 2: rt/imu/data and sensor_msgs::msg::dds_::Imu_. `listen` prints one line for
// each message: seconds nanoseconds frame gyro.x accel.z gyro_covariance[0].

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <thread>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>

#include "ImuPubSubTypes.h"

using namespace eprosima::fastdds::dds;

int main(int argc, char** argv)
{
    if (argc < 4)
        return 2;
    bool publishes = std::string(argv[1]) == "publish";
    auto* participant =
        DomainParticipantFactory::get_instance()->create_participant(std::atoi(argv[2]), PARTICIPANT_QOS_DEFAULT);
    TypeSupport type(new sensor_msgs::msg::dds_::Imu_PubSubType());
    type.register_type(participant, "sensor_msgs::msg::dds_::Imu_");
    auto* topic = participant->create_topic("rt/imu/data", "sensor_msgs::msg::dds_::Imu_", TOPIC_QOS_DEFAULT);
    std::printf("ready\n");
    std::fflush(stdout);
    if (publishes)
    {
        DataWriterQos qos = DATAWRITER_QOS_DEFAULT;
        qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
        auto* writer = participant->create_publisher(PUBLISHER_QOS_DEFAULT)->create_datawriter(topic, qos);
        double rate = std::atof(argv[3]);
        long count = std::atol(argv[4]);
        auto begin = std::chrono::steady_clock::now();
        for (long k = 0; k < count; ++k)
        {
            sensor_msgs::msg::dds_::Imu_ message;
            long long stamp = 1700000000000000000LL + static_cast<long long>(k * 1e9 / rate + 0.5);
            message.header().stamp().sec(static_cast<int32_t>(stamp / 1000000000LL));
            message.header().stamp().nanosec(static_cast<uint32_t>(stamp % 1000000000LL));
            message.header().frame_id("fastdds");
            message.angular_velocity().x(static_cast<double>(k));
            message.angular_velocity().y(0.25);
            message.linear_acceleration().z(9.8125 + static_cast<double>(k));
            writer->write(&message);
            std::this_thread::sleep_until(begin + std::chrono::duration<double>((k + 1) / rate));
        }
        return 0;
    }
    auto* reader =
        participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT)->create_datareader(topic, DATAREADER_QOS_DEFAULT);
    for (long count = std::atol(argv[3]); count > 0;)
    {
        sensor_msgs::msg::dds_::Imu_ message;
        SampleInfo info;
        reader->wait_for_unread_message({1, 0});
        while (count > 0 && reader->take_next_sample(&message, &info) == ReturnCode_t::RETCODE_OK)
        {
            if (!info.valid_data)
                continue;
            --count;
            std::printf("%d %u %s %.17g %.17g %.17g\n", message.header().stamp().sec(),
                        message.header().stamp().nanosec(), message.header().frame_id().c_str(),
                        message.angular_velocity().x(), message.linear_acceleration().z(),
                        message.angular_velocity_covariance()[0]);
            std::fflush(stdout);
        }
    }
    return 0;
}
