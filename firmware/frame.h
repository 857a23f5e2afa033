/* Frames of TBP v2: COBS(header payload crc32) 00. */
#ifndef FRAME_H
#define FRAME_H

#include "messages.h"

enum frame_header { VERSION_NODE_BYTE, ID_BYTE, SEQ_BYTE, SESSION_BYTE, FRAME_HEADER };
#define FRAME_CRC_SIZE 4
#define FRAME_MAX_RAW (FRAME_HEADER + MAX_PAYLOAD + FRAME_CRC_SIZE)
#define FRAME_MAX_ENCODED (FRAME_MAX_RAW + 1)
#define FRAME_MAX_WIRE (FRAME_MAX_ENCODED + 1)

enum frame_result { FRAME_NONE, FRAME_OK, FRAME_LENGTH, FRAME_COBS, FRAME_CRC };

struct frame_decoder {
	uint8_t data[FRAME_MAX_ENCODED]; /* encoded, then raw: decoded in place */
	uint8_t length;                  /* FRAME_MAX_ENCODED + 1: too long, skipping */
	uint8_t raw_length;              /* of the frame just completed */
};

uint32_t frame_crc(const uint8_t *data, uint8_t length);

/* Encodes into wire (FRAME_MAX_WIRE bytes); returns the length with the closing 00. */
uint8_t frame_encode(uint8_t *wire, const uint8_t header[FRAME_HEADER], const void *payload,
		     uint8_t payload_length);

/* Takes one byte. FRAME_OK: decoder->data holds header, payload and CRC, raw_length bytes. */
enum frame_result frame_feed(struct frame_decoder *decoder, uint8_t byte);

#endif
